"""What a calibration by turning looks at: where the vehicle stood still, how tilted, how far it turned."""

from mavcompass.calibration.observation.detector import WHEELED as WHEELED
from mavcompass.calibration.observation.detector import StillnessDetector as StillnessDetector
from mavcompass.calibration.observation.detector import unrest as unrest
from mavcompass.calibration.observation.dwells import Dwell as Dwell
from mavcompass.calibration.observation.dwells import FourPositionData as FourPositionData
from mavcompass.calibration.observation.dwells import Step as Step
from mavcompass.calibration.observation.dwells import dwell_between as dwell_between
from mavcompass.calibration.observation.dwells import latest_dwells as latest_dwells
from mavcompass.calibration.observation.stillness import accelerometer_of as accelerometer_of
from mavcompass.calibration.observation.stillness import assemble as assemble
from mavcompass.calibration.observation.stillness import find_dwells as find_dwells
from mavcompass.calibration.observation.stillness import observe as observe
from mavcompass.calibration.observation.stillness import turns_between as turns_between
from mavcompass.calibration.observation.turning import TurnRecord as TurnRecord
from mavcompass.calibration.observation.turning import turn_record as turn_record
