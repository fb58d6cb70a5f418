"""The peak resident memory of this process, where the system tells."""

from __future__ import annotations

import sys


def peak_bytes() -> int | None:
    """Return the most memory that this process has held so far, in bytes; None on Windows."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak
