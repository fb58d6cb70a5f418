"""`python -m odescope`."""

from odescope.cli import entry

entry()
