"""`python -m odescope`."""

from odescope.cli import main

main()
