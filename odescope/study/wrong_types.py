"""What msgspec says of a value of the wrong type or size, in the words of TOML."""

from __future__ import annotations

import re

_TYPES = {
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}
_CAME = _TYPES | {"float": "one with decimals"}
_MESSAGE = re.compile(
    r"^Expected `(?P<wanted>[^`]*)`(?P<bound> [^-]*?)?(?:, got `(?P<came>[^`]*)`)?(?: - at `(?P<path>.*)`)?$", re.DOTALL
)


def in_words_of_toml(message: str) -> str:
    """Return what a value must be and what it is, where a message of msgspec is about that; else the message."""
    found = _MESSAGE.search(message)
    if found is None:
        return message
    wanted = " or ".join(_TYPES.get(name, name) for name in found["wanted"].split(" | ") if name != "null")
    came = "" if found["came"] is None else f", not {_CAME.get(found['came'], found['came'])}"
    what_to_do = ": put it in [brackets]" if (found["wanted"], found["came"]) == ("array", "str") else ""
    return f"`{found['path'] or 'the study'}` must be {wanted}{found['bound'] or ''}{came}{what_to_do}"
