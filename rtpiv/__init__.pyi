from daq.verbs.acquire import acquire as acquire
from daq.verbs.calibrate import calibrate as calibrate
from daq.verbs.correct import correct as correct
from daq.verbs.evaluate import evaluate as evaluate
from daq.verbs.mean import mean as mean
from daq.verbs.report import report as report
from daq.verbs.trace import trace as trace
from tracer.scene_file import load_scene as load_scene

ERRORS: tuple[type[Exception], ...]
__version__: str
