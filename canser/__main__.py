"""`python -m canser` is the command `canser`."""

import sys

from canser.cli import main

sys.exit(main())
