"""``python -m onboard``: one vehicle's agent."""

import sys

from onboard.agent.main import main

if __name__ == "__main__":
    sys.exit(main())
