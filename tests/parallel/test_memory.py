import subprocess
import sys
import textwrap

import pytest

from odescope.parallel.memory import peak_bytes

pytestmark = pytest.mark.skipif(peak_bytes() is None, reason="this system does not tell")


def printed(code):
    """Run code in a process of its own, whose peak no other test has raised, and return the numbers it prints."""
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=True)
    return [float(word) for word in run.stdout.split()]


def test_the_peak_is_in_bytes_and_stays_after_the_memory_is_freed():
    before, during, after = printed("""
        import numpy as np
        from odescope.parallel.memory import peak_bytes
        before = peak_bytes()
        held = np.ones(25_000_000)
        during = peak_bytes()
        del held
        print(before, during, peak_bytes())
    """)
    assert during - before == pytest.approx(200e6, rel=0.015)  # 1 024 bytes a kB, not 1 000
    assert after > during - 5e6  # the system's own count lags by some pages


def test_a_process_is_not_told_the_peak_of_the_one_that_started_it():
    large, small = printed("""
        import subprocess, sys
        import numpy as np
        from odescope.parallel.memory import peak_bytes
        held = np.ones(50_000_000)
        print(peak_bytes(), flush=True)
        code = "from odescope.parallel.memory import peak_bytes; print(peak_bytes())"
        subprocess.run([sys.executable, "-c", code], check=True)
    """)
    assert small < large - 300e6


def test_what_a_stage_takes_is_counted_at_its_end_and_not_before():
    """A differentiator that needs 600 MB: the stage of the signals must show it, that of the records must not."""
    stages = printed("""
        import msgspec, numpy as np
        from odescope import Data, Measured, Study, identify
        from odescope.likelihood.search import LikelihoodSearch
        from odescope.signals.differentiators import Spectral


        class Greedy:
            def derivatives(self, channel, period, order):
                held = np.ones(75_000_000)
                return Spectral().derivatives([c * held[0] for c in channel], period, order)


        t = 0.02 * np.arange(1500)
        x = np.exp(-0.1 * t) * np.cos(2.0 * t) + 1e-4 * np.random.default_rng(0).standard_normal(1500)
        study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, likelihood=LikelihoodSearch(False))
        greedy = msgspec.structs.replace(study.signals, differentiator=Greedy())
        result = identify(msgspec.structs.replace(study, signals=greedy), {"t": t, "x": x})
        print(*(result.memory[stage] for stage in ("records", "signals", "regression", "model")))
    """)
    assert stages[1] - stages[0] > 500e6
    assert stages == sorted(stages)
