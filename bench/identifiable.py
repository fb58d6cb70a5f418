"""What the data of the machines could tell, before any method is asked: the weakest mechanism of every level.

    ./run python bench/identifiable.py --machines arms rotary --seeds 2

First the equations of motion by hand, from which the data come, are held against the truth: the residual of its
relations, and free runs over short stretches. Then for every level the least coefficient in standard errors, by the
Cramer-Rao bound. A coefficient that sets the scale has none of its own.
"""

from __future__ import annotations

import argparse

import numpy as np
from bounds import TOLERANCE, cramer_rao, inputs_of, sensitivities
from catalogue import MACHINES
from machines import Machine, Recordings

from odescope import simulate
from odescope.library.tape import evaluate, write_tape

STRETCH = 0.5  # seconds


def residual(machine: Machine, clean: Recordings) -> float:
    """Return the largest residual of the truth's relations at the derivatives by hand, over the sum of its terms."""
    model, worst = machine.truth.simulated(), 0.0
    after = {c.target: model.states.index(c.derivative(c.order - 1)) for c in model.coordinates}
    for run, states in zip(clean, machine.states(clean), strict=True):
        u = inputs_of(model, run)
        rates = np.array([machine.rate(s, v) for s, v in zip(states, np.column_stack([u, u[:, :0]]), strict=True)])
        columns = np.ascontiguousarray(np.column_stack([states, u]).T)
        for relation in model.relations:
            terms = relation.terms
            values = evaluate(write_tape(model.variables, [t.term for t in terms]), columns)
            factors = np.array([rates[:, after[t.factor]] if t.factor else np.ones(len(u)) for t in terms])
            sizes = np.array([t.coefficient for t in terms])[:, None] * factors * values
            worst = max(worst, float((np.abs(sizes.sum(0)) / np.abs(sizes).sum(0).max()).max()))
    return worst


def departure(machine: Machine, clean: Recordings) -> float:
    """Return how far free runs of the truth leave the data within a stretch, in standard deviations of a state."""
    model, worst = machine.truth.simulated(), 0.0
    spread = np.concatenate(machine.states(clean)).std(axis=0)
    for run, states in zip(clean, machine.states(clean), strict=True):
        t, u = run["t"], inputs_of(model, run)
        step = max(2, round(STRETCH / (t[1] - t[0])))
        for begin in range(0, len(t) - 1, step):
            piece = slice(begin, begin + step + 1)
            found = simulate(model, t[piece], u[piece], states[begin], *TOLERANCE).states
            worst = max(worst, float((np.abs(found - states[piece]) / spread).max()))
    return worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", nargs="+", choices=MACHINES, default=list(MACHINES))
    parser.add_argument("--friction", type=float, nargs="+", default=[0.01, 0.15], help="of the cart's joint")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--detail", action="store_true", help="a line for every mechanism, and the ranges")
    options = parser.parse_args()
    for name in options.machines:
        for friction in options.friction if name == "cart" else [0.0]:
            machine = MACHINES[name](friction)
            truth = machine.truth
            for seed in range(options.first, options.first + options.seeds):
                clean = machine.runs(seed)
                states = machine.states(clean)
                runs = sensitivities(truth, clean, states)
                where = f"{name} b1={friction}" if name == "cart" else name
                print(
                    f"{where} seed {seed}: {len(truth.mechanisms)} mechanisms, {len(truth.free)} free; residual"
                    f" {residual(machine, clean):.1e}, free runs leave by {departure(machine, clean):.1e}"
                )
                for level in machine.noise:
                    covariance = cramer_rao(truth, states, machine.sigma(clean, level), runs)
                    sure = {k: abs(truth.theta[k]) / np.sqrt(covariance[k, k]) for k in truth.free}
                    weakest = min(sure, key=sure.__getitem__)
                    print(f"   level {level}: weakest {truth.mechanisms[weakest]}: {sure[weakest]:.1f}")
                    for k in sure if options.detail else ():
                        print(f"      {truth.mechanisms[k]!s:<45} {sure[k]:10.1f}")
                if options.detail:
                    whole = np.concatenate(states)
                    for k, state in enumerate(truth.model.states):
                        low, high, spread = whole[:, k].min(), whole[:, k].max(), whole[:, k].std()
                        print(f"      {state}: {low:.3g} to {high:.3g}, standard deviation {spread:.3g}")


if __name__ == "__main__":
    main()
