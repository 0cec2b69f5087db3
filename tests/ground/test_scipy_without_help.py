"""SciPy as a command imports it: the same numbers, no help made, NumPy left as it was."""

import json
import subprocess
import sys

PROGRAM = """
import json, sys
import numpy
if sys.argv[1] == "command":
    from ground.scipy_without_help import leave_help_out
    leave_help_out()
    leave_help_out()
names, parts = list(numpy.__all__), set(dir(numpy))
import scipy.ndimage, scipy.spatial, scipy.optimize, scipy.linalg, scipy.interpolate, scipy.special
made = [name in sys.modules for name in ("numpy.f2py", "numpy.testing")]
same = names == list(numpy.__all__) and parts <= set(dir(numpy))
array = numpy.random.default_rng(1).normal(size=(40, 40))
numbers = [
    scipy.ndimage.gaussian_filter(array, 1.5), scipy.ndimage.median_filter(array, 3),
    scipy.ndimage.label(array > 0)[0],
    scipy.spatial.cKDTree(array).query(array[:5], 3)[0], scipy.linalg.cholesky(array @ array.T + numpy.eye(40)),
    scipy.optimize.brentq(numpy.cos, 0.0, 3.0), scipy.interpolate.CubicSpline(range(40), array)(2.2),
    scipy.special.fdtri(3, 40, 0.9), scipy.special.logsumexp(array),
]
import scipy.stats
numbers.append(scipy.stats.norm.ppf(0.3))
import numpy.f2py, numpy.testing
print(json.dumps({
    "numbers": [numpy.asarray(one, float).tobytes().hex() for one in numbers], "made": made, "same": same,
    "help": [scipy.ndimage.gaussian_filter.__doc__, scipy.special.logsumexp.__doc__, scipy.stats.norm.__doc__],
}))
"""


def said(how: str) -> dict:
    return json.loads(subprocess.run([sys.executable, "-c", PROGRAM, how], check=True, capture_output=True).stdout)


def test_numbers_are_the_same_and_nothing_of_numpy_is_lost():
    command, program = said("command"), said("program")
    assert command["numbers"] == program["numbers"]
    assert command["same"]
    assert program["same"]


def test_no_help_is_made_for_a_command_and_all_for_a_program():
    command, program = said("command"), said("program")
    assert command["made"] == [False, False]
    assert len(command["help"][0]) < len(program["help"][0])  # no table of other libraries
    assert "sigma" in command["help"][0]
    assert "Array API" in program["help"][0]
