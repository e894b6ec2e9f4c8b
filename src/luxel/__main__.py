"""``python -m luxel``."""

import sys

from luxel.app.cli import main

if __name__ == "__main__":
    sys.exit(main())
