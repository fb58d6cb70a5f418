"""The machines by name; all but the paper's cart leave its joint friction aside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from bare import BARE
from machines import Machine, arms, cart, cart_dry, enzyme, late, rotary, stepped

MACHINES: dict[str, Callable[[float], Machine]] = {
    "cart": cart,
    **{
        name: lambda _, make=make: make()
        for name, make in {
            "arms": arms,
            "rotary": rotary,
            "enzyme": enzyme,
            "cart-dry": cart_dry,
            "cart-dry-late": lambda: replace(cart_dry(), spoilt=late),
            "cart-dry-steps": lambda: stepped(cart_dry(), (0.0002, 2 * np.pi / 4096)),
            "arms-dry": partial(arms, dry=True),
            "arms-dry-late": lambda: replace(arms(dry=True), spoilt=late),
            "arms-dry-steps": lambda: stepped(arms(dry=True), (2 * np.pi / 4096,) * 2),
            **BARE,
        }.items()
    },
}
