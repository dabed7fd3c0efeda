"""Make sealed cases in a process of their own, so that nothing of their labels reaches the diagnosis.

python -m mavcompass.gap.trial FOLDER --cases 40 --seed 7
"""

import argparse
from pathlib import Path

from mavcompass.gap.trial.label import GENERATORS, TIERS
from mavcompass.gap.trial.sealed import seal

parser = argparse.ArgumentParser(description="Make sealed cases for a blind trial.")
parser.add_argument("folder", type=Path)
parser.add_argument("--cases", type=int, default=40)
parser.add_argument("--seed", type=int, default=1)
parser.add_argument("--tier", choices=TIERS)
parser.add_argument("--generator", choices=GENERATORS, default="bench")
arguments = parser.parse_args()
seal(arguments.folder, arguments.cases, arguments.seed, arguments.tier, arguments.generator)
