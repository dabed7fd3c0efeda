"""Run the program as `python -m mavcompass`."""

import sys

from mavcompass.cli.main import main

sys.exit(main())
