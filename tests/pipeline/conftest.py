"""Fixtures that several files of tests share."""

from __future__ import annotations

import importlib

import pytest
from reduce_cases import long_log, written

from odescope.commands.demo import simulate_log


@pytest.fixture(scope="module")
def log():
    log = simulate_log(0, 1)
    return {"t": log.t, "x": log.measured[:, 0], "phi": log.measured[:, 1], "u": log.force}


@pytest.fixture(scope="module")
def lengthy():
    return long_log()


@pytest.fixture(scope="module")
def folder(tmp_path_factory, lengthy):
    return written(tmp_path_factory.mktemp("log"), lengthy)


@pytest.fixture(scope="module")
def systems():
    return importlib.import_module("systems")
