import sys
from pathlib import Path

# Last on the path: benches are scripts that import each other by name, and tests have files of like names.
sys.path.append(str(Path(__file__).parents[1] / "bench"))
