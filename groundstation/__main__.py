"""``python -m groundstation`` is the ``covey`` command."""

import sys

from groundstation.cli import main

if __name__ == "__main__":
    sys.exit(main())
