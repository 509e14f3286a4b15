"""`speed/device.py` under its documented path: python benchmarks/bench_device.py --help."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # the repository, which holds `benchmarks`

from benchmarks.speed.device import main

if __name__ == "__main__":
    main()
