"""``python -m benchmarks`` is ``fleet bench``."""

import sys

from fleet_cli.main import main

if __name__ == "__main__":
    sys.argv.insert(1, "bench")
    main()
