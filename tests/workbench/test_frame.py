"""Small parts of pages that can be tried without a browser."""

import asyncio
import time
from urllib.parse import unquote, urlsplit

import pytest

pytest.importorskip("nicegui")

from odescope.errors import InputError
from odescope.workbench import frame
from odescope.workbench.frame import Latest, stored


@pytest.fixture(autouse=True)
def threads(monkeypatch):
    async def aside(act, *given):
        return await asyncio.get_running_loop().run_in_executor(None, act, *given)

    monkeypatch.setattr(frame, "aside", aside)


def asked(*jobs):
    """Ask for each job while the one before it is running, and return what came of each, and how many ran."""
    latest, ran = Latest(), []

    def run(seconds, name):
        ran.append(name)
        time.sleep(seconds)
        if name.startswith("bad"):
            raise InputError(name)
        return name

    async def all_of_them():
        tasks = []
        for job in jobs:
            tasks.append(asyncio.create_task(latest.of(run, *job)))
            await asyncio.sleep(0.02)
        return await asyncio.gather(*tasks, return_exceptions=True)

    return asyncio.run(all_of_them()), ran


def test_the_last_that_was_asked_for_is_shown_however_long_those_before_take():
    assert asked((0.3, "slow"), (0.0, "between"), (0.05, "last")) == ([None, None, "last"], ["slow", "last"])


def test_what_went_wrong_is_said_of_the_last_alone():
    (first, last), _ = asked((0.2, "bad first"), (0.0, "last"))
    assert (first, last) == (None, "last")
    (first, last), _ = asked((0.2, "first"), (0.0, "bad last"))
    assert first is None
    assert isinstance(last, InputError)


@pytest.mark.parametrize("name", ["run #1", "50 % more?", "a&b=c", "Müller/2"])
def test_the_address_of_a_file_means_that_file(name):
    parts = urlsplit(f"http://localhost{stored(name, 'report.html')}")
    assert (parts.query, parts.fragment) == ("", "")
    assert unquote(parts.path) == f"/stored/{name}/report.html"
