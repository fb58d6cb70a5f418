"""Write odescope/__init__.pyi, which tells editors and type checkers where the lazy names live: python .ci/stub.py.

The table in odescope/__init__.py is the truth; the stub is drawn from it, and a test compares the two.
"""

from __future__ import annotations

from pathlib import Path

import odescope

HEAD = "# Drawn from the table in __init__.py: change the table, then run `./run python .ci/stub.py`.\n"


def stub() -> str:
    """Return the text of the stub: one line for each public name, in the order that ruff wants."""
    homes = sorted((module, _kind(name), name) for name, module in odescope._HOME.items())
    lines = [f"from odescope.{module} import {name} as {name}\n" for module, _, name in homes]
    return HEAD + "".join(lines) + "\n__version__: str\n"


def _kind(name: str) -> int:
    """Return the rank of constants, classes and functions, in which imports of one module are sorted."""
    return 0 if name.isupper() else 1 if name[0].isupper() else 2


if __name__ == "__main__":
    path = Path(odescope.__file__).with_suffix(".pyi")
    path.write_text(stub(), encoding="utf-8")
    print(f"wrote {path.name}: {len(odescope._HOME)} names")
