"""The terminal: what it writes, and one clear line with exit code 2 for bad input."""

from __future__ import annotations

import argparse
import contextlib
import inspect
import json
import re
import runpy
import shlex
import signal
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import phase_ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.cli import commands, main
from phase_ppl.cli.commands import APPLICATIONS
from phase_ppl.inference.compare import entries
from phase_ppl.world.files import locked
from phase_ppl.world.goals import GOALS
from tests.analysis.factory import Simulation, hypothesis, make_tree
from tests.analysis.readings import reading
from tests.inference.toy import walkers, walking_event
from tests.simulator.toys import wait_until
from tests.world.examples import make_event

pytestmark = pytest.mark.usefixtures("unpainted")

Capture = pytest.CaptureFixture[str]

ALONE = ["--workers", "1", "--quiet"]
TOY = ["--kernel", "prior_mh", "--option", "early_reject=false", "--chains", "4"]


def fails(capsys: Capture, *arguments: object) -> str:
    """Return the only line of an error with exit code 2."""
    try:
        code = main([str(argument) for argument in arguments])
    except SystemExit as stop:
        code = stop.code
    written = capsys.readouterr()
    assert code == 2
    assert written.err.count("\n") == 1
    assert "Traceback" not in written.err
    return written.err


def told(capsys: Capture, *arguments: object) -> str:
    """Return what a command prints that ends well."""
    capsys.readouterr()
    assert main([str(argument) for argument in arguments]) == 0
    return capsys.readouterr().out


@pytest.fixture
def walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An event of the toy world, which is simulated instead of the real one."""
    monkeypatch.setattr(phase_ppl.Model, "build_simulator", lambda self: walkers)
    path = tmp_path / "walk.json"
    phase_ppl.save_event(walking_event(5), path)
    return path


def test_infer_writes_its_results_over_those_of_another_run_only_where_told_to(
    walk: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    command = ["infer", walk, *TOY, "--iterations", 1, *ALONE, "--out", out]
    told(capsys, *command)
    files = {path.name: path.read_bytes() for path in out.iterdir()}
    assert set(files) == {"posterior.nc", "summary.json", "posterior.png", "replay.mp4"}
    assert min(map(len, files.values())) > 1000
    summary = json.loads(files["summary.json"])
    assert set(summary) >= {
        *("goals", "relation", "scenario", "strengths", "map", "diagnostics", "settings", "cost")
    }
    for agent in ("red agent", "green agent"):
        assert set(summary["goals"][agent]) == set(GOALS)
        assert sum(summary["goals"][agent].values()) == pytest.approx(1)
    assert set(summary["cost"]) >= {"simulations", "seconds", "workers", "host"}
    assert "workers" not in json.dumps(summary["settings"])
    said = "holds results already (posterior.nc, summary.json, posterior.png, replay.mp4)"
    assert said in fails(capsys, *command)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == files
    with locked(out):
        assert "another process is at work" in fails(capsys, *command, "--overwrite")
    for name in ("posterior.nc", "why.png"):
        (out / name).write_text("of another run")
    told(capsys, *command, "--overwrite")
    assert phase_ppl.load_posterior(out / "posterior.nc").event_id == "walk"
    assert not (out / "why.png").exists()


def test_resume_extends_a_run_beside_its_file_and_then_deletes_it(
    walk: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    length = ["--budget", 8, "--keep-checkpoint"]
    told(capsys, "infer", walk, *ALONE, *TOY, *length, "--out", out)
    assert "unfinished run" in fails(capsys, "infer", walk, "--out", out)
    file = out / "run.ckpt"
    assert "too small" in fails(capsys, "resume", file, "--budget", 4, *ALONE)
    told(capsys, "resume", file, "--iterations", 2, *ALONE)
    assert not file.exists()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["settings"]["iterations"] == 2
    assert summary["settings"]["kernel"] == {"name": "prior_mh", "early_reject": False}
    assert summary["cost"]["calls"] == 2


def fails_later(given: Any) -> None:
    raise ValueError("not today")


def is_interrupted(given: Any) -> None:
    signal.raise_signal(signal.SIGINT)
    wait_until(lambda: False)  # which the run ends as soon as it has noticed


@pytest.mark.parametrize(
    ("end", "code", "said"),
    [
        (fails_later, 2, "phase-ppl: error: .*not today"),
        (is_interrupted, 130, "phase-ppl: interrupted"),
    ],
)
def test_a_run_that_ends_early_leaves_results_and_a_file(
    end: Any,
    code: int,
    said: str,
    walk: Path,
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[int] = []

    def ends(*given: Any) -> Any:
        calls.append(1)
        if len(calls) == 6:
            end(given)
        yield from walkers(*given)

    monkeypatch.setattr(phase_ppl.Model, "build_simulator", lambda self: ends)
    out = tmp_path / "out"
    more = ["--on-failure", "raise", "--out", str(out)]
    assert main(["infer", str(walk), *ALONE, *TOY, *more]) == code
    written = capsys.readouterr()
    assert re.search(said, written.err)
    assert "Go on with: phase-ppl resume" in written.out
    assert (out / "posterior.nc").exists()
    told(capsys, "resume", out / "run.ckpt", "--iterations", 1, *ALONE)


def test_compare_writes_table_and_figure(walk: Path, tmp_path: Path, capsys: Capture) -> None:
    tiny = ["--budget", 8, "--repeats", 1, "--chains", 4, *ALONE]
    kernels = ["--kernels", "prior_mh", "--reference", "none"]
    assert "expected 'enumeration'" in fails(capsys, "compare", walk, *tiny, *kernels[:-1], "best")
    again = ["compare", walk, *kernels, *tiny, "--out", tmp_path]
    assert "P(goals)" in told(capsys, *again)
    assert (tmp_path / "comparison.png").stat().st_size > 1000
    assert "holds results already (comparison.json, " in fails(capsys, *again)
    kept = fails(capsys, *again, "--checkpoint", tmp_path / "comparison.json")
    assert "(comparison.png)" in kept
    record = json.loads((tmp_path / "comparison.json").read_text())
    assert record["runs"]["kernel"] == ["prior_mh"]


def test_compare_takes_presets_beside_kernels(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    asked: dict[str, Any] = {}

    def compare(**given: Any) -> Any:
        asked.update(given)
        raise phase_ppl.SimulationError("asked")

    compare.__signature__ = inspect.signature(phase_ppl.compare)  # type: ignore[attr-defined]
    monkeypatch.setattr(phase_ppl, "compare", compare)
    assert "asked" in fails(capsys, "compare", "collaborate", "--kernels", "as_printed,prior_mh")
    printed, other = entries(asked["kernels"], 7, phase_ppl.SimpleSettings())
    assert (printed.label, printed.kernel, printed.options) == (
        *("as_printed", "local_mh"),
        {"rule": "paper"},
    )
    assert printed.own == {"planner": "as_printed", "iterations": 6}
    assert (other.kernel, other.chains, other.own) == ("prior_mh", 7, {})


def test_simulate_writes_files_that_the_commands_take_up(tmp_path: Path, capsys: Capture) -> None:
    goals = ["--goal", "red agent=red agent to red lm", "--goal", "green agent=get to red agent"]
    for name in ("event.json", "film.mp4"):
        out = ["--out", tmp_path / name]
        told(capsys, "simulate", "collaborate", *goals, "--frames", 3, *out)
    assert phase_ppl.load_event(tmp_path / "event.json").observation.n_frames == 3
    assert (tmp_path / "film.mp4").stat().st_size > 1000
    for event, name in (("event.json", "a.mp4"), ("event.json", "x.png")):
        told(capsys, "render", tmp_path / event, "--out", tmp_path / name)
        assert (tmp_path / name).stat().st_size > 1000


def test_render_draws_a_strip_or_a_frame_with_or_without_fields_of_view(
    tmp_path: Path, capsys: Capture
) -> None:
    short = tmp_path / "walk.json"
    plain, tinted = tmp_path / "plain.png", tmp_path / "a folder" / "tinted.png"
    phase_ppl.save_event(make_event(n_frames=3), short)
    for event, options, size in (
        ("oppose", [], (1800, 336)),
        (short, [], (900, 336)),  # has no more frames
        ("oppose", ["--strip", 2], (600, 336)),
        ("oppose", ["--frame", -1], (640, 480)),
    ):
        said = told(capsys, "render", event, *options, "--out", plain)
        assert event == short or "of oppose written to" in said
        told(capsys, "render", event, *options, "--fields-of-view", "--out", tinted)
        with Image.open(plain) as first, Image.open(tinted) as second:
            assert first.size == second.size == size
            assert first.tobytes() != second.tobytes()


def test_help_gives_an_example(capsys: Capture) -> None:
    names = {
        *("infer", "resume", "compare", "query", "diagnose", "report", "goals", "simulate"),
        *("evaluate", "compare-models", "reproduce", "render", "describe", "export"),
        *("generate", "train", "fit-people", "read-video", "study"),
    }
    parts = ["new", "run", "status", "export", "withdraw", "exclude", "demo", "simulate"]
    for command in ([], *([name] for name in names), *(["study", part] for part in parts)):
        with pytest.raises(SystemExit) as stop:
            main([*command, "--help"])
        assert stop.value.code == 0
        said = capsys.readouterr().out
        assert "example: phase-ppl" in said, command
        listed = {line.split()[0] for line in said.splitlines() if line.strip()}
        assert command or names <= listed
        assert command != ["study"] or set(parts) <= listed


def test_commands_of_the_docs_are_accepted(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    done: list[Any] = []
    monkeypatch.setattr(commands, "_executor", lambda address: contextlib.nullcontext())
    monkeypatch.setattr(commands.Parser, "set_defaults", lambda parser, run: (
        argparse.ArgumentParser.set_defaults(parser, run=done.append)))  # fmt: skip
    root = Path(__file__).parents[1]
    for page in (root / "README.md", *sorted((root / "docs").glob("*.md"))):
        text = page.read_text("utf-8").replace("\\\n", " ")
        for line in re.findall(r"^ *(?:\.venv/bin/)?phase-ppl (.*)", text, re.MULTILINE):
            words = shlex.split(line.partition("&&")[0], comments=True)
            assert main(words) == 0, (page.name, line)
    assert len(done) > 60
    assert not capsys.readouterr().err


def test_a_command_of_an_application_that_cannot_be_loaded_leaves_the_others(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def entry(name: str, place: str) -> EntryPoint:
        return EntryPoint(name, place, APPLICATIONS)

    points = EntryPoints(
        [entry("broken", "no.such:command"), entry("study", "phase_study.terminal")]
    )
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points.select(group=group))
    assert main(["broken"]) == 2
    said = capsys.readouterr().err
    assert said == "phase-ppl: error: command 'broken' cannot be loaded: No module named 'no'\n"
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    told = capsys.readouterr()
    assert stop.value.code == 0
    assert "Put events before people" in told.out
    assert told.err == said.replace("error", "note")
    assert main(["goals"]) == 0
    with pytest.raises(SystemExit):
        main(["study", "--help"])
    assert not capsys.readouterr().err


BAD_INPUT = [
    ("simulate collaborate --goal 'red agent=Get blue item to red landmark' --out x.json",
     "Get blue item to red lm"),
    ("infer collaborate --video other", "'other'"),
    ("infer collaborate --likelihood radial", "which takes a kernel that samples"),
    ("infer collaborate --watch --kernel prior_mh --on-failure raise --option rule=paper",
     "the closed loop, which samples nothing: no --kernel, --on-failure, --option rule"),
    ("infer collaborate --chains 3", "chains=3 is for sampling, and no kernel is named"),
    ("infer collaborate --seed 1 --seed 2", "--seed: given twice, 1 and 2"),
    ("infer collaborate --model closed_loop --kernel smc --out o --on-failure raise",
     "on_failure='raise' is for simulations"),
    ("resume file", "no checkpoint"),
    ("render collaborate --frame 3 --out x.mp4", "--frame draws a picture: --out"),
    ("render collaborate --strip 3 --frame 1 --out x.png", "not allowed"),
    ("render collaborate --strip 999 --out x.png", "n=999, expected one of 1..54"),
    ("compare collaborate --kernels local_mh,prior_hm", "'prior_mh'"),
    ("compare collaborate --kernels local_mh,", "different names"),
    ("compare short.json --kernels prior_mh --reference enumeration:per_pair",
     "--reference: 'per_pair'"),
    ("infre collaborate", "unknown choice 'infre'; did you mean 'infer'?"),
    ("study run", "arguments are required: FOLDER"),
]  # fmt: skip
SAMPLING = "infer short.json --quiet --kernel local_mh"
SETTINGS = [
    ("--budget 60m", "seconds, as in 60s"),
    ("--budget 29", "need 30"),
    ("--budget 60s --iterations 2", "not allowed"),
    ("--option rule=paper --option rule=exact", "given twice"),
]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [*BAD_INPUT, *((f"{SAMPLING} {text}", said) for text, said in SETTINGS)],
)
def test_bad_input_is_one_line(
    arguments: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_bytes(b"PK\x03\x04 and no more")
    phase_ppl.save_event(make_event(n_frames=12), "short.json")
    assert message in fails(capsys, *shlex.split(arguments))


class TestQuery:
    """The command ``query``, on a posterior made by hand."""

    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        folder = tmp_path / "my results"
        folder.mkdir()
        both = hypothesis("Get blue item to red lm", "Get blue item to red lm")
        other = hypothesis("get to green agent", "Get pink item to blue lm")
        simulations = [Simulation(h, seed) for seed, h in enumerate([both, both, both, other])]
        draws = [[chain, chain] for chain in range(4)]
        post = phase_ppl.Posterior(make_tree(simulations, draws))
        post.save(folder / "posterior.nc")
        return folder

    def test_answers_are_printed_with_their_errors(self, folder: Path, capsys: Capture) -> None:
        questions = [
            *("P(relation = friendly)", "P(goal_red)", "mode relation", "H(goal_red, goal_green)"),
            *("hdi strength_red", "top 1 relation|goal_red=get to green agent"),
        ]
        assert told(capsys, "query", folder, *questions).splitlines() == [
            "P(relation = friendly) = 0.75 ± 0.25",
            "P(goal_red):",
            "  0.75 ± 0.25  Get blue item to red lm",
            "  0.25 ± 0.25  get to green agent",
            "mode relation = friendly (another leads with probability 0.2)",
            "H(goal_red, goal_green) = 0.6 ± 0.5",
            "hdi strength_red = 300 ± unknown to 300 ± unknown",
            "top 1 relation|goal_red=get to green agent:",
            "  1 ± unknown  neutral",
        ]

    def test_json_is_the_same_as_plain_data(self, folder: Path, capsys: Capture) -> None:
        questions = ["E strength_red", "P(relation, sign_red)", "P(sign_red=to | relation=neutral)"]
        top = "top 1 (relation | goal_red=get to green agent)"
        questions += ["mode relation", "hdi strength_red", top]
        said = told(capsys, "query", folder, *questions, "--json", "--weights", "count")
        mean, table, given, mode, interval, most = json.loads(said)
        assert mean == {"question": "E strength_red", "value": 300.0, "error": None}
        assert table["values"] == [
            {"relation": name, "sign_red": "to", "probability": p, "error": pytest.approx(0.25)}
            for name, p in (("friendly", 0.75), ("neutral", 0.25))
        ]
        assert given["error"] is None
        assert (mode["value"], mode["error"]) == ("friendly", pytest.approx(0.198, abs=1e-3))
        assert interval["bounds"] == [{"value": 300.0, "error": None}] * 2
        assert most["values"] == [{"value": "neutral", "probability": 1.0, "error": None}]

    def test_a_wrong_question_is_shown_with_its_place(self, folder: Path, capsys: Capture) -> None:
        wrong, good = "P(relation=freindly)", "P(relation=friendly)"
        assert main(["query", str(folder), "P(x)", good, wrong, "mode relation"]) == 1
        written = capsys.readouterr()
        assert [line[:12] for line in written.out.splitlines()] == ["P(relation=f", "mode relatio"]
        assert written.err.count("phase-ppl: error: ") == 2
        assert main(["query", str(folder), wrong]) == 2
        written = capsys.readouterr()
        assert written.out == ""
        assert written.err.splitlines() == [
            "phase-ppl: error: unknown relation 'freindly'; did you mean 'friendly'?",
            "  P(relation=freindly)",
            "             ^",
        ]


HUT = """
import phase_ppl
hut = phase_ppl.World(
    ["Ann", "Ben"], ["pot"], {"fire": (4, 4)}, arena=(0, 16, 0, 12), name="hut",
    predicates=[phase_ppl.Predicate("a chat", "Ann", "Ben", within=5)],
)
event = phase_ppl.simulate(
    hut.scene(start={"Ann": (3, 9), "Ben": (12, 9), "pot": (12, 3)}, size=0.8),
    goals={"Ann": "a chat", "Ben": "pot to fire"}, frames=3,
)
"""


def test_goals_and_simulations_of_worlds_of_ones_own(tmp_path: Path, capsys: Capture) -> None:
    source, kept, out = (tmp_path / name for name in ("hut.py", "hut.json", "new.json"))
    source.write_text(HUT)
    event = runpy.run_path(str(source))["event"]
    phase_ppl.save_event(event, kept)
    assert told(capsys, "goals").splitlines() == list(GOALS)
    for world in (f"{source}:hut", kept):
        said = told(capsys, "goals", "--world", world)
        assert said.splitlines() == list(event.scene.world.goals)
    assert "unknown world 'hut'" in fails(capsys, "goals", "--world", "hut")
    simulate = ["simulate", kept, "--frames", 3, "--out", out]
    roles = ["--goal", "Ann = pot to fire", "--relation", "Ben=hinder=Ann", "--strength", "Ben=300"]
    told(capsys, *simulate, *roles)
    made = phase_ppl.load_event(out)
    assert made.truth == phase_ppl.Hypothesis.of(
        event.scene.world, {"Ann": "pot to fire"}, {("Ben", "Ann"): "hinder"}, {"Ben": 300}
    )
    goals = ["--goal", "red agent=get to green agent", "--relation", "green agent=hinder=red agent"]
    told(capsys, "simulate", "collaborate", *goals, "--frames", 3, "--out", out)
    truth = phase_ppl.load_event(out).truth
    assert isinstance(truth, phase_ppl.Truth)
    assert truth.goal_green == "get away from red agent"
    for wrong, message in {
        (): "the Ann has no goal, and helps or hinders nobody",
        ("--goal", "Ann"): "'Ann' is not of the form NAME=GOAL",
        ("--goal", "Ann=a chat", "--relation", "Ben=Ann"): "expected WHO=help=WHOM",
        ("--goal", "Ann=a chat", "--goal", "Ben=pot to fire", "--strength", "Ben=big"): "'big'",
    }.items():
        assert message in fails(capsys, *simulate, *wrong)


def test_a_prior_is_taken_out_of_a_file(tmp_path: Path, capsys: Capture) -> None:
    kept = str(ClosedLoopPosterior(reading()).save(tmp_path / "post.nc"))
    source = tmp_path / "mine.py"
    source.write_text(
        "import jax.numpy as jnp, numpyro, numpyro.distributions as dist\n"
        "import phase_ppl as ppl\n\n\n"
        "def aloof():\n"
        '    numpyro.sample("alpha", dist.Categorical(probs=jnp.eye(5)[0]))\n'
        "    ppl.sites.goals()\n    ppl.sites.strengths()\n"
    )
    question = "P(alpha=(0, 0))"
    assert main(["query", kept, question, "--prior", f"{source}:aloof"]) == 0
    said = capsys.readouterr()
    assert f"{question} = 1" in said.out
    assert f"running {source} for its prior aloof" in said.err
    assert main(["query", kept, question, "--prior", f"{source}:alof"]) == 2
    assert "aloof" in capsys.readouterr().err
    assert main(["query", kept, question, "--prior", f"{tmp_path}/none.py:aloof"]) == 2
    assert main(["query", kept, question, "--prior", "sparse_social"]) == 0


MINE = """
import numpy as np
from phase_ppl.inference.kernels.metropolis import PriorMH

def still(scene, hypothesis, rng):
    while True:
        yield np.array(scene.start)

def plain(program):
    return PriorMH(program)

class Flat:
    def __init__(self, beta=0.01): self.beta = beta
    def log_prob(self, errors): return -self.beta * errors
    def max_total_error(self, log_floor, n_frames): return -log_floor / self.beta

flat = Flat(0.5)
"""


class TestOwnParts:
    """Simulators, kernels and likelihoods out of a file, and settings of likelihoods."""

    @pytest.fixture
    def asked(self, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
        """Return what inference is asked for, which then ends."""
        found: dict[str, Any] = {}
        signature = inspect.signature(phase_ppl.infer)

        def infer(event: Any, model: Any, **given: Any) -> Any:
            found.update(given, model=model)
            raise phase_ppl.SimulationError("asked")

        infer.__signature__ = signature  # type: ignore[attr-defined]
        monkeypatch.setattr(phase_ppl, "infer", infer)
        return found

    def test_they_are_what_inference_gets(
        self, tmp_path: Path, asked: dict[str, Any], capsys: Capture
    ) -> None:
        file = tmp_path / "mine.py"
        file.write_text(MINE)
        own = {name: f"{file}:{name}" for name in ("still", "plain", "Flat", "flat")}
        given = ["--simulator", own["still"], "--kernel", own["plain"]]
        sampling = ["--kernel", "local_mh"]
        given += ["--likelihood", f"{own['Flat']}:beta=0.2"]
        assert main(["infer", "collaborate", *given]) == 2
        assert f"running {file} for its simulator still" in capsys.readouterr().err
        model = asked["model"]
        assert (model.simulator.__name__, asked["kernel"].__name__) == ("still", "plain")
        assert model.likelihood.beta == 0.2
        assert main(["infer", "collaborate", *sampling, "--likelihood", own["flat"]]) == 2
        assert asked["model"].likelihood.beta == 0.5
        capsys.readouterr()
        given = [*sampling, "--likelihood", "radial:beta=0.3"]
        assert "asked" in fails(capsys, "infer", "collaborate", *given)
        assert asked["model"].likelihood == phase_ppl.RadialLikelihood(0.3)
        # those of the closed loop, in two ways
        settings = ["weight=1", "planner_seeds=2", "tail=5"]
        expected = phase_ppl.ClosedLoopLikelihood(
            weight=1, planner_seeds=2, tracking=phase_ppl.Tracking(tail=5)
        )
        for options in (
            ["--model", "closed_loop", *(word for one in settings for word in ("--option", one))],
            ["--likelihood", ":".join(["closed_loop", *settings])],
        ):
            assert "asked" in fails(capsys, "infer", "collaborate", *options)
            assert asked["model"].likelihood == expected

    def test_the_closed_loop_reads_unless_a_kernel_samples(
        self, asked: dict[str, Any], capsys: Capture
    ) -> None:
        reading = phase_ppl.ClosedLoopLikelihood()
        guided = {"settings": phase_ppl.SimpleSettings(proposal="closed_loop")}
        for words, likelihood, sampling in (
            ("", reading, {}),
            ("--model closed_loop --kernel smc", reading, {"kernel": "smc"}),
            ("--likelihood closed_loop --kernel smc", reading, {"kernel": "smc"}),
            ("--kernel smc", None, {"kernel": "smc"}),
            ("--model simple", None, {"kernel": "local_mh"}),
            ("--preset guided", None, {"kernel": "local_mh", **guided}),
            ("--model simple --preset guided", None, {"kernel": "local_mh", **guided}),
            ("--model simple --kernel smc", None, {"kernel": "smc"}),
        ):
            asked.clear()
            assert "asked" in fails(capsys, "infer", "collaborate", *words.split())
            assert asked["model"].likelihood == likelihood, words
            found = {name: asked.get(name) for name in ("kernel", "settings")}
            assert {k: v for k, v in found.items() if v is not None} == sampling, words

    @pytest.mark.parametrize(
        ("given", "said"),
        [
            ("--simulator FILE:stil", "did you mean 'still'?"),
            ("--likelihood radial:beta", "'beta' in 'radial:beta' is no OPTION=VALUE"),
            ("--likelihood closed_loop:speed=1", "unexpected keyword argument 'speed'"),
            ("--model closed_loop --likelihood radial", "is not that of --model closed_loop"),
            ("--model simple --likelihood closed_loop", "is not that of --model simple"),
            ("--simulator FILE:still --planner fast", "planner applies to the joint simulator"),
        ],
    )
    def test_what_cannot_be_is_refused(
        self, given: str, said: str, tmp_path: Path, capsys: Capture
    ) -> None:
        (tmp_path / "mine.py").write_text(MINE)
        words = given.replace("FILE", str(tmp_path / "mine.py")).split()
        assert main(["infer", "collaborate", *words]) == 2
        *_, last = capsys.readouterr().err.splitlines()
        assert said in last
