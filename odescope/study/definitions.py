"""Functions of one's own as a study spells them: "drag(v)" = "v*abs(v)"."""

from __future__ import annotations

import re

from odescope.errors import InputError
from odescope.library.parse import Definition


def definition(head: str, body: str) -> Definition:
    """Return the definition of a function.

    Raises:
        InputError: what stands on the left is no name with arguments.
    """
    spelled = re.fullmatch(r"\s*([A-Za-z_]\w*)\s*\(\s*([A-Za-z_]\w*(?:\s*,\s*[A-Za-z_]\w*)*)\s*\)\s*", head, re.ASCII)
    if spelled is None:
        raise InputError(f'[library.functions] wants "name(argument, ...)" = "expression"; {head!r} came')
    return Definition(spelled[1], tuple(p.strip() for p in spelled[2].split(",")), body)
