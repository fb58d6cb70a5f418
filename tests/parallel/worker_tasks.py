"""What the tests of workers and local_processes share."""

import os
import signal
import time
from pathlib import Path


def die_once(i, array, folder, fatal):
    """Take the worker down with the task, the first time."""
    flag = Path(folder) / str(i)
    if i in fatal and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return i + array.sum()
