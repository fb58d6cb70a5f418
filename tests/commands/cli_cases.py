"""What the tests of cli and cli_options share."""

from logs import (
    OSCILLATOR,
    oscillator,
)

STUDY = '[data]\nfiles = ["run.csv"]\ntime = "t"\n' + OSCILLATOR


LOG = oscillator()
