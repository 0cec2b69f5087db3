from rtpiv.verbs.acquire import LiveFrames as LiveFrames
from rtpiv.verbs.acquire import acquire as acquire
from rtpiv.verbs.calibrate import calibrate as calibrate
from rtpiv.verbs.correct import CorrectionRecipe as CorrectionRecipe
from rtpiv.verbs.correct import correct as correct
from rtpiv.verbs.evaluate import evaluate as evaluate
from rtpiv.verbs.mean import mean as mean
from rtpiv.verbs.report import report as report
from rtpiv.verbs.trace import trace as trace
from tracer.scene.scene_file import load_scene as load_scene

ERRORS: tuple[type[Exception], ...]
__version__: str
