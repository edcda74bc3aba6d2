"""`python -m camtopod` is the console script."""

import sys

from camtopod.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
