"""A record with its inputs laid out as they act, of which pieces can be cut."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from odescope.model.integration import Drive
from odescope.model.model import Model
from odescope.model.simulation import drive, known_from
from odescope.recordings.record import Record


@dataclass(frozen=True, eq=False)
class DrivenRecord:
    """A record, or a piece of one, and the inputs of a model as they act in it.

    Inputs are laid out once a record: in a piece acts what was recorded before it began, or after it ends. Of the first
    `known` samples that is not so, since it was not recorded at all: no model can be compared with these.
    """

    record: Record
    driven: Drive
    known: int

    @staticmethod
    def of(model: Model, record: Record) -> DrivenRecord:
        """Return a whole record; the inputs of the model are columns of it."""
        inputs = np.array([record.column(i.name) for i in model.inputs]).reshape(len(model.inputs), len(record)).T
        return DrivenRecord(record, drive(model.inputs, record.t, inputs), known_from(model.inputs, record.t))

    def part(self, first: int, stop: int) -> DrivenRecord:
        """Return the samples [first, stop) of the record."""
        return DrivenRecord(self.record.part(first, stop), self.driven.part(first, stop), max(self.known - first, 0))

    def compared(self, model: Model) -> Record:
        """Return the record with counts of 0 for coordinates that no model can be compared with."""
        if not self.known:
            return self.record
        counts = np.column_stack([self.record.counted(name) for name in self.record.names])
        counts[: self.known, [self.record.names.index(c.name) for c in model.coordinates]] = 0.0
        return replace(self.record, counts=counts)
