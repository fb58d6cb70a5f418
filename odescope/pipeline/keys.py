"""Under which name the factors of a study are kept."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path

import msgspec

from odescope.pipeline.streaming import Store
from odescope.study.options import Study
from odescope.study.pieces import tables, versions

SECTIONS = ("coordinates", "inputs", "library", "signals")  # that what is kept depends on, beside data and rows
OWN = ("signals.differentiator", "regression.rows")  # the pieces among these that may be of one's own


def store_of(folder: Path | None, study: Study) -> Store | None:
    """Return the store of a study: what is kept depends on the options up to the rows of the regression.

    There is none for a differentiator or rows that no installed package offers: nothing could tell whether they are
    still what they were when something was kept.
    """
    if folder is None:
        return None
    said, unsaid = tables(study)
    if any(u.where in OWN for u in unsaid):
        return None
    data = {key: value for key, value in said["data"].items() if key != "files"}
    sections = [said[name] for name in SECTIONS if name in said]
    options = (version("odescope"), versions(study), data, sections, said["regression"]["rows"])
    return Store(folder, hashlib.sha256(msgspec.json.encode(options)).hexdigest())
