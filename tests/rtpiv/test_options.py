"""What the command line offers beside its verbs: completion, threads, examples, news of compiling."""

import os
import shutil
import subprocess

import pytest

from ground import compile_news
from ground.compile_news import CompileCount
from rtpiv.command_line.cli import DONE, THREADS, USAGE, main, print_compiling
from rtpiv.command_line.completion_script import completion_script
from rtpiv.options import parser


def completed(tmp_path, *words):
    """What bash offers for the last word."""
    script = tmp_path / "completion.sh"
    script.write_text(completion_script(parser(), "bash"))
    line = " ".join(f'"{word}"' for word in words)
    program = (
        f'source {script}; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _rtpiv; echo "${{COMPREPLY[@]}}"'
    )
    ran = subprocess.run(["bash", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    return ran.stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_completion(tmp_path):
    (tmp_path / "scene.yaml").touch()
    assert completed(tmp_path, "rtpiv", "tr") == ["trace"]
    assert {"init", "check", "--version"} <= set(completed(tmp_path, "rtpiv", ""))
    assert completed(tmp_path, "rtpiv", "acquire", "--sim") == ["--simulate"]
    assert completed(tmp_path, "rtpiv", "correct", "--method", "q") == ["quintic"]
    assert completed(tmp_path, "rtpiv", "camera", "l") == ["list"]
    assert completed(tmp_path, "rtpiv", "trace", "sc") == ["scene.yaml"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_verb_is_in_every_script(shell, capsys):
    assert main(["completion", shell]) == DONE
    script = capsys.readouterr().out
    for verb in ("init", "check", "acquire", "report", "schema", "doctor", "devices"):
        assert verb in script


@pytest.mark.parametrize("before", [True, False])
def test_threads(monkeypatch, tmp_path, before):
    for name in THREADS:
        monkeypatch.setenv(name, "")
    words = ["examples", str(tmp_path / "examples")]
    assert main(["--threads", "3", *words] if before else [*words, "--threads", "3"]) == DONE
    assert [os.environ[name] for name in THREADS] == ["3"] * len(THREADS)
    assert (tmp_path / "examples" / "demo" / "scene.yaml").is_file()
    assert main(["examples", str(tmp_path / "examples")]) == USAGE
    (tmp_path / "empty").mkdir()
    assert main(["examples", str(tmp_path / "empty")]) == DONE
    assert (tmp_path / "empty" / "tour.py").is_file()
    with pytest.raises(SystemExit):
        main(["--threads", "0", "completion", "bash"])


def test_compiling_is_said_once_and_goes_on(capsys, monkeypatch):
    told = []
    monkeypatch.setattr(compile_news, "watch", lambda functions, seconds: told.append(functions))
    monkeypatch.setattr(compile_news, "SAY_EVERY_S", 0.0)
    count = CompileCount()
    for _ in range(2):
        count.begun()
        count.done()
    assert told == [0, 1, 2]
    print_compiling(0, 0.0)
    print_compiling(7, 12.3)
    said = capsys.readouterr().err
    assert (
        said == "compiling, first use on this computer, less than a minute in all\ncompiling: 7 functions, 12 s\n"
    )


def test_a_kernel_that_no_cache_holds_is_news(monkeypatch):
    import numba

    import ground.compiler  # noqa: F401 - listens

    told = []
    monkeypatch.setattr(compile_news, "SAY_EVERY_S", 0.0)
    monkeypatch.setattr(compile_news, "watch", lambda functions, seconds: told.append(functions))
    numba.njit(lambda x: x + 1)(3)
    assert told
