"""Fixtures that several files of tests share."""

import pytest

from odescope.recordings import text_files


@pytest.fixture
def _small_steps(monkeypatch):
    """Let small files have many marks, and lines that go over the blocks in which they are counted."""
    monkeypatch.setattr(text_files, "MARK_ROWS", 8)
    monkeypatch.setattr(text_files, "BLOCK_BYTES", 61)
