"""What the command line offers beside its verbs: completion, threads, examples, news of compiling."""

import dataclasses
import importlib
import inspect
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import rtpiv.verbs
from ground.jit import compile_news
from ground.jit.compile_news import CompileCount
from rtpiv.analysis.pairs.piv_file import PivOptions
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.command_line.cli import DONE, THREADS, USAGE, main, print_compiling
from rtpiv.options.command import REMOVED, RENAMED, VERBS, call_of, commands, current, parser
from rtpiv.options.signature import REQUIRED, signature
from rtpiv.verbs.completion import completion_script
from tests.loops import loop_over

OFFERED = {
    ("tr",): ["trace"],
    ("acquire", "--sim"): ["--simulate"],
    ("correct", "--method", "q"): ["quintic"],
    ("bench", "camera", "l"): ["list"],
    ("bench", "st"): ["stage"],
    ("acquire", "--resume", "--ret"): ["--retake"],
    ("trace", "sc"): ["scene.yaml"],
}


def completed(folder, lines):
    """What bash offers for the last word of each line."""
    program = [completion_script("bash")]
    for words in lines:
        line = " ".join(f'"{word}"' for word in ("rtpiv", *words))
        program.append(f'COMP_WORDS=({line}); COMP_CWORD={len(words)}; _rtpiv; echo "${{COMPREPLY[@]}}"')
    command = ["bash", "-c", "\n".join(program)]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return [line.split() for line in ran.stdout.splitlines()]


def test_every_function_is_a_command_and_at_most_twenty_verbs_are_listed():
    homes = sorted(Path(rtpiv.verbs.__file__).parent.glob("*.py"))
    named = {home.stem: re.match(r'"""`rtpiv ([^`]+)`: ', home.read_text(encoding="utf-8")) for home in homes}
    assert {found[1]: name for name, found in named.items() if found} == {
        command: function for command, function in commands().items() if command != "mean --line"
    }
    assert len(VERBS) <= 20
    help_text = parser().format_help()
    assert [re.search(rf"^  {verb} +\w", help_text, re.MULTILINE) for verb in VERBS].count(None) == 0


@loop_over(
    "old, new",
    [
        ("stage where --home", "bench stage where --home"),
        ("--threads 2 examples place", "--threads 2 setup examples place"),
        ("resume run --retake", "acquire --resume run --retake"),
        ("join a b -o out", "mean --join a b -o out"),
        ("timeseries series --line 0 0 1 1", "mean series --line 0 0 1 1"),
        ("probe /dev/ttyUSB0", "doctor --probe /dev/ttyUSB0"),
        ("devices", "doctor"),
    ],
)
def test_a_renamed_verb_is_read_as_its_new_name_and_named_once(old, new):
    words, notice = current(old.split())
    assert words == new.split()
    assert f"rtpiv {' '.join(RENAMED[next(each for each in old.split() if each in RENAMED)].split())};" in notice
    function = vars(parser(words).parse_args(words))["verb"]
    assert function == {"devices": "doctor"}.get(each := next(w for w in old.split() if w in RENAMED), each)
    assert current(words) == (words, "")


def test_a_removed_verb_says_what_replaces_it(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["benchmark", "scene.yaml"])
    assert caught.value.code == USAGE
    assert capsys.readouterr().err.splitlines() == [f"rtpiv benchmark has been removed: {REMOVED['benchmark']}"]


def test_a_renamed_verb_still_works_and_names_the_new_one_on_standard_error(tmp_path, capsys):
    assert main(["schema", "-o", str(tmp_path)]) == DONE
    said = capsys.readouterr().err
    assert said == "rtpiv schema is now rtpiv setup schema; the old name goes with the next release\n"
    assert (tmp_path / "scene.schema.json").is_file()


@loop_over("verb", sorted(set(commands().values())))
def test_what_a_verb_takes_is_what_its_function_takes(verb):
    """Read from the source, and as Python itself says it."""
    function = getattr(importlib.import_module(f"rtpiv.verbs.{verb}"), verb)
    options = signature(verb)
    own = {option.name: option for option in options if option.of is None}
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in own:
            holders = [option for option in options if option.holder == name]
            assert holders, name
            assert all(option.of == holders[0].of for option in holders)
            continue
        assert own[name].is_word == (parameter.kind is parameter.POSITIONAL_ONLY), name
        if parameter.default is not parameter.empty:
            assert own[name].default == parameter.default, name
    for option in options:
        assert option.help, f"{verb} {option.name}: is described nowhere"
        if option.of is not None and not option.of.keywords:
            made = getattr(importlib.import_module(option.of.module), option.of.name)
            known = {field.name: field.default for field in dataclasses.fields(made)}
            assert option.default is REQUIRED or option.default == known[option.name], option.name


def test_values_are_put_together():
    words = ["correct", "a.tif", "b.tif", "--scene", "scene.yaml", "--dewarp-order", "3", "--float"]
    options = vars(parser(words).parse_args(words))
    (frames,), named = call_of("correct", options)
    assert frames == [Path("a.tif"), Path("b.tif")]
    assert named["recipe"] == CorrectionRecipe(dewarp_order=3)
    assert (named["scene"], named["resampling"].as_float, named["pictures"]) == (Path("scene.yaml"), True, True)
    words = ["mean", "run", "--overlap", "0.75"]
    _, named = call_of("mean", vars(parser(words).parse_args(words)))
    assert named["overlap"] == 0.75
    assert not set(PivOptions.__annotations__) - {"overlap"} & set(named)


@loop_over(
    "words, said",
    [
        ("calibrate run --square-mm 20,5", "should be a number, not '20,5'; write a decimal point: 20.5"),
        ("calibrate run --square-mm 0", "should be above 0, not 0"),
        ("mean run --passes two", "should be a whole number, not 'two'"),
        ("mean run --workers 0", "should be 1, 2, 3 ..., not '0'"),
        ("correct a.tif", "required: --scene"),
        ("bench live --port 70000", "should be 0 to 65535"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(words, said, capsys):
    with pytest.raises(SystemExit):
        main(words.split())
    assert said in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_completion(tmp_path):
    (tmp_path / "scene.yaml").touch()
    *offered, for_nothing = completed(tmp_path, [*OFFERED, ("",)])
    assert offered == list(OFFERED.values())
    assert {"init", "check", "--version"} <= set(for_nothing)


@loop_over("shell", ["bash", "zsh", "fish"])
def test_every_verb_is_in_every_script(shell, capsys):
    assert main(["setup", "completion", shell]) == DONE
    script = capsys.readouterr().out
    for verb in ("init", "check", "acquire", "report", "setup", "schema", "doctor", "stage"):
        assert verb in script


@pytest.mark.parametrize("before", [True, False])
def test_threads(monkeypatch, tmp_path, before):
    for name in THREADS:
        monkeypatch.setenv(name, "")
    words = ["setup", "examples", str(tmp_path / "examples")]
    assert main(["--threads", "3", *words] if before else [*words, "--threads", "3"]) == DONE
    assert [os.environ[name] for name in THREADS] == ["3"] * len(THREADS)
    assert (tmp_path / "examples" / "demo" / "scene.yaml").is_file()
    assert main(["setup", "examples", str(tmp_path / "examples")]) == USAGE
    (tmp_path / "empty").mkdir()
    assert main(["setup", "examples", str(tmp_path / "empty")]) == DONE
    assert (tmp_path / "empty" / "tour.py").is_file()
    with pytest.raises(SystemExit):
        main(["--threads", "0", "completion", "bash"])


def test_compiling_is_said_once_and_goes_on(capsys, monkeypatch):
    told = []
    monkeypatch.setattr(compile_news, "watch", lambda functions, seconds: told.append(functions))
    monkeypatch.setattr(compile_news, "SAY_EVERY_S", 0.0)
    count = CompileCount()
    for _ in range(2):
        count.start()
        count.finish()
    assert told == [0, 1, 2]
    print_compiling(0, 0.0)
    print_compiling(7, 12.3)
    said = capsys.readouterr().err
    assert (
        said
        == "compiling, first use on this computer, one to three minutes in all\ncompiling: 7 functions, 12 s\n"
    )


def test_a_kernel_that_no_cache_holds_is_news(monkeypatch):
    import numba

    import ground.jit.compiler  # noqa: F401 - listens

    told = []
    monkeypatch.setattr(compile_news, "SAY_EVERY_S", 0.0)
    monkeypatch.setattr(compile_news, "watch", lambda functions, seconds: told.append(functions))
    numba.njit(lambda x: x + 1)(3)
    assert told


def test_what_turns_something_off_says_what_is_not_done():
    text = " ".join(parser({"init"})._subparsers._group_actions[0].choices["init"].format_help().split())
    assert "--yes do not ask at the terminal for what is not given" in text


@loop_over(
    "verb, given, meant",
    [
        ("init", "--f-mm", "--lens-mm"),
        ("init", "--focal-length-mm", "--lens-mm"),
        ("init", "--lense-mm", "--lens-mm"),
        ("init", "--pixel-size-um", "--pixel-pitch-um"),
        ("init", "--diameter-mm", "--ball-mm"),
        ("evaluate", "--dt_us", "--dt-us"),
        ("evaluate", "--mm-pr-px=0.1", "--mm-per-px"),
        ("acquire", "--simulated", "--simulate"),
        ("init", "--xyzzy", ""),
        ("init", "-q", ""),
    ],
)
def test_an_option_that_nearly_exists_is_named(verb, given, meant, capsys):
    """A stranger says the focal length as other programs do."""
    with pytest.raises(SystemExit):
        main([verb, "place", given, "3"])
    said = " ".join(capsys.readouterr().err.split())
    assert (f"did you mean {meant}?" in said) == bool(meant), said
    assert ("did you mean" in said) == bool(meant)
