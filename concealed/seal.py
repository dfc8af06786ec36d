"""Sealed keys: a published hash that binds who wrote a key, and a cipher that keeps it from who may not read it.

The hash is SHA-256 over a random salt and the key's text, so that no guess at a key can be checked against it. The keys
with their salts are encrypted (Fernet: AES-128-CBC with HMAC-SHA-256) under a secret made for one suite.
"""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from cryptography.fernet import Fernet, InvalidToken


class BrokenSealError(Exception):
    """A key cannot be read, or is not the one whose hash was published."""


def secret() -> bytes:
    """A new secret."""
    return Fernet.generate_key()


def text(key: Mapping[str, Any]) -> str:
    """A key as the text that is hashed: equal keys, equal text."""
    return json.dumps(key, sort_keys=True, separators=(",", ":"))


def digest(key: Mapping[str, Any], salt: str) -> str:
    """What is published of a key: 64 hexadecimal digits."""
    return hashlib.sha256(f"{salt}\n{text(key)}".encode()).hexdigest()


def seal(keys: Mapping[str, Mapping[str, Any]], salts: Mapping[str, str], by: bytes) -> bytes:
    """All keys with their salts, encrypted."""
    inside = {name: {"salt": salts[name], "key": key} for name, key in keys.items()}
    return Fernet(by).encrypt(json.dumps(inside).encode())


def unseal(sealed: bytes, by: bytes, published: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """The keys; BrokenSealError where the secret is another one, or a key is not what was published."""
    try:
        inside = json.loads(Fernet(by).decrypt(sealed))
    except (InvalidToken, ValueError):
        raise BrokenSealError("the keys do not open with this secret: it belongs to another suite.") from None
    wrong = [n for n, k in inside.items() if digest(k["key"], k["salt"]) != published.get(n)]
    if wrong or inside.keys() != published.keys():
        raise BrokenSealError(f"{len(wrong)} keys are not those whose hashes were published, such as {wrong[:1]}.")
    return {name: k["key"] for name, k in inside.items()}
