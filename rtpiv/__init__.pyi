from daq.bench.rehearsal import Rehearsal as Rehearsal
from rtpiv.analysis.pairs.evaluation import PairDetails as PairDetails
from rtpiv.analysis.recipe import CorrectionRecipe as CorrectionRecipe
from rtpiv.analysis.recipe import Resampling as Resampling
from rtpiv.verbs.acquire import LiveFrames as LiveFrames
from rtpiv.verbs.acquire import acquire as acquire
from rtpiv.verbs.calibrate import calibrate as calibrate
from rtpiv.verbs.correct import correct as correct
from rtpiv.verbs.evaluate import EvaluationOutput as EvaluationOutput
from rtpiv.verbs.evaluate import evaluate as evaluate
from rtpiv.verbs.mean import MeanOutput as MeanOutput
from rtpiv.verbs.mean import mean as mean
from rtpiv.verbs.report import report as report
from rtpiv.verbs.trace import trace as trace
from tracer.scene.scene_file import load_scene as load_scene

ERRORS: tuple[type[Exception], ...]
__version__: str
