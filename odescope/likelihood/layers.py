"""How long a step of RK4 may be where dry friction changes its sign: short within the layer of tanh(v/w) alone.

A joint moves most of the time, and passes the layer within a fraction of a step. Every segment has steps of its own,
which follow from where it is and how fast it nears the layer. docs/method.md, Parameters beside coefficients.
"""

from __future__ import annotations

from typing import NamedTuple

from odescope.arrays import IntArray
from odescope.parallel.kernels import kernel

STABLE = 1.5  # rate of decay within the layer times step: RK4 is stable to 2.8
RESOLVED = 1.0  # layer widths that v may change by in a step within the layer
EDGE = 3.0  # layer widths from standstill to where friction is constant: but for half a per cent
NEARER = 0.5  # of the way to the edge at the present rate, that a step may go
MOST_STEPS = 256  # of RK4 an average that dry friction may ask for


class Layers(NamedTuple):
    """Where a tape has what dry friction depends on, z = v/w in tanh(z).

    Shapes: slot (L,) of z; slope (L, variables) slots of its derivatives by states and inputs, -1 where there is none;
    part (Q, 2): a layer, and a part that is friction within it.
    """

    slot: IntArray
    slope: IntArray
    part: IntArray


@kernel("contract", inline=True)
def step_lengths(slot, slope, part, weight, owner, following, work, inv, dx, du, lanes, step, h):
    """Shorten the next steps h (L,) of all lanes, as shares of an average of `step` seconds, where a layer is near.

    Within a layer v decays at the rate of what friction F adds to it by z: the inverse of A times F dz/dv. The step
    keeps rate times step below `STABLE`, and v from passing the layer unseen; outside it goes a part of the way there.

    Args:
        slot: as slope and part those of `Layers`.
        slope: see there.
        part: see there.
        weight: (parts,) coefficients, shares included.
        owner: (parts,) relation of each.
        following: (n,) as in `Frame`.
        work: (slots, L) the tape where the step begins.
        inv: (T, T, L) the inverse of A there.
        dx: (n, L) rates of the states there.
        du: (inputs, L) rates of the inputs.
        lanes: how many there are.
        step: length of an average in seconds.
        h: (L,) shares of the average, what is usual to begin with.
    """
    n = following.shape[0]
    for f in range(slot.shape[0]):
        acts = False
        for q in range(part.shape[0]):
            if part[q, 0] == f and weight[part[q, 1]] != 0.0:
                acts = True
        if not acts:
            continue
        for lane in range(lanes):
            rate, speed = 0.0, 0.0
            for i in range(slope.shape[1]):
                if slope[f, i] < 0:
                    continue
                by = work[slope[f, i], lane]
                speed += by * (dx[i, lane] if i < n else du[i - n, lane])
                if i < n and following[i] < 0:
                    for q in range(part.shape[0]):
                        if part[q, 0] == f:
                            rate += by * inv[-1 - following[i], owner[part[q, 1]], lane] * weight[part[q, 1]]
            fast = step * abs(speed)
            within = max(1.0 / max(step * abs(rate) / STABLE, fast / RESOLVED), 1.0 / MOST_STEPS)
            clear = NEARER * (abs(work[slot[f], lane]) - EDGE) / fast
            wanted = clear if clear > within else within
            if wanted < h[lane]:
                h[lane] = wanted
