"""Fixtures that several files of tests share."""

import pytest
from cli_cases import LOG
from logs import (
    Command,
    write,
)


@pytest.fixture
def odescope(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    return Command(monkeypatch, capsys)


@pytest.fixture
def run(odescope):
    write("run.csv", LOG)
    return odescope
