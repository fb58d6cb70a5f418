"""The command that opens the workbench, where it cannot."""

import socket
import sys

import pytest


def test_without_its_packages_it_says_how_to_get_them(odescope, monkeypatch):
    for name in [n for n in sys.modules if n.startswith(("odescope.workbench.server", "nicegui"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "nicegui", None)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert "pip install odescope[web]" in odescope.refused("workbench")


def test_a_folder_that_is_none_and_a_port_that_is_taken_are_told(odescope):
    pytest.importorskip("nicegui")
    assert "nowhere is no folder" in odescope.refused("workbench", "nowhere")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert f"port {port} is taken" in odescope.refused("workbench", "--port", port)
