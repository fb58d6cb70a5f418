"""A simulated reactor: what flows in and out, and a rate that saturates."""

import numpy as np

from odescope.study.options import Candidates, Data, Driven, Measured, Study

N = 2000
T = 0.2 * np.arange(N)


def reactor(seed):
    """Substrate and product of a rate that the product inhibits, in a tank with a feed of changing strength."""
    rng = np.random.default_rng(seed)
    flow, level = (np.repeat(rng.uniform(*ends, N // 20), 20) for ends in ((0.05, 0.5), (1.0, 6.0)))
    x, rows = np.array([2.0, 1.0]), []

    def rate(x, d, f):
        v = 1.1 * x[0] / (0.64 + 0.7 * x[1] + x[0])
        return np.array([d * f - d * x[0] - v, v - d * x[1]])

    for d, f in zip(flow, level, strict=True):
        rows.append(x)
        for _ in range(4):
            h = 0.05
            a = rate(x, d, f)
            b = rate(x + 0.5 * h * a, d, f)
            c = rate(x + 0.5 * h * b, d, f)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(x + h * c, d, f))
    clean = np.array(rows)
    s, p = (clean + 0.003 * clean.std(axis=0) * rng.standard_normal(clean.shape)).T
    return {"t": T, "S": s, "P": p, "D": flow, "F": level}


STUDY = Study(
    data=Data(time="t"),
    coordinates={"S": Measured(order=1), "P": Measured(order=1)},
    inputs={"D": Driven(hold="zero", delay=0.0), "F": Driven(hold="zero", delay=0.0)},
    library=Candidates(suspect=False),
)
