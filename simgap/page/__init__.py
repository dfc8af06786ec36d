"""The HTML page of a diagnosis: `render.page` fills a jinja2 template with what `view` takes from the statement."""
