"""`python -m odescope`."""

from odescope.commands.cli import entry

entry()
