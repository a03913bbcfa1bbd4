"""`python -m sitl --fleet FILE`."""

import sys

from sitl.server import main

if __name__ == "__main__":
    sys.exit(main())
