"""`python -m canser` is the command `canser`."""

import sys

from canser.commands.cli import main

sys.exit(main())
