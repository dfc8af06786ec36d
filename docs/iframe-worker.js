/* Search where the site is opened as a file: browsers start no worker there, so the search runs in a hidden frame. */
window.IFrameWorker = class extends EventTarget {
  constructor(url) {
    super();
    url = new URL(url, document.baseURI).href;
    const frame = document.createElement("iframe");
    frame.hidden = true;
    document.body.appendChild(frame);
    const inside = frame.contentWindow;
    inside.postMessage = data => this.dispatchEvent(new MessageEvent("message", { data }));
    inside.importScripts = (...urls) => urls.reduce((done, each) => done.then(() => load(each)), Promise.resolve());
    const load = each => new Promise((resolve, reject) => {
      const script = inside.document.createElement("script");
      script.src = new URL(each, url).href;
      script.onload = resolve;
      script.onerror = () => reject(new Error(script.src));
      inside.document.body.appendChild(script);
    });
    this.ready = load(url);
    this.inside = inside;
  }
  postMessage(data) {
    this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data })));
  }
};
if (location.protocol === "file:") window.Worker = window.IFrameWorker;
