"""``python -m sitl`` is the ``covey sitl`` command."""

import sys

if __name__ == "__main__":
    from groundstation.cli import main

    sys.exit(main(["sitl", *sys.argv[1:]]))
