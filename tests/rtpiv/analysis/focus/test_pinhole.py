"""A focus scan on a bench that is simulated with a pinhole is refused before it moves, with the lines it lacks."""

from rtpiv.command_line.cli import USAGE, main
from tests.daq.small_bench import write_bench

PLAN = "experiment: focus\nz_mm: [-20.0, -10.0, 0.0, 10.0, 20.0]\npixel_pitch_um: 11.0\n"


def test_a_pinhole_has_no_focus(tmp_path, capsys):
    path = write_bench(tmp_path, 96, "samples: 1")
    (tmp_path / "plan.yaml").write_text(PLAN)
    words = ["acquire", str(tmp_path / "plan.yaml"), "--bench", str(path), "--simulate", "--home", "--no-correct"]
    assert main([*words, "-o", str(tmp_path / "runs")]) == USAGE
    said = " ".join(capsys.readouterr().err.split())
    assert "the simulated lens is a pinhole, which is sharp at every distance" in said
    assert "aperture: simulation: {aperture: {f_mm: " in said
    assert not (tmp_path / "runs").exists()
