"""The four-position calibration: the fit of still positions, what disturbed it, what it cannot tell."""

from mavcompass.calibration.positions.four_positions import WIDENED_BELOW as WIDENED_BELOW
from mavcompass.calibration.positions.four_positions import FourPositionsResult as FourPositionsResult
from mavcompass.calibration.positions.four_positions import next_pose as next_pose
from mavcompass.calibration.positions.four_positions import solve_four_positions as solve_four_positions
from mavcompass.calibration.positions.four_positions import unobserved as unobserved
from mavcompass.calibration.positions.problem import PositionProblem as PositionProblem
