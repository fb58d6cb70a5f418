"""JSON of typed values, among them numbers that numpy computed."""

from __future__ import annotations

import msgspec
import numpy as np


def encoded(value: object) -> bytes:
    """Return a value as JSON, numbers of numpy as what they are."""
    return msgspec.json.encode(value, enc_hook=_item)


def _item(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(type(value).__name__)
