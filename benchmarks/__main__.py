"""`python -m benchmarks`: every comparison, one after the other."""

import sys

from benchmarks.robot import main

sys.exit(main())
