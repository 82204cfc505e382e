"""The events that come with the package."""

from __future__ import annotations

from pathlib import Path

import pytest

from phase_ppl.dataset import load
from phase_ppl.dataset.load import bundled_events, load_event, load_events, save_event
from phase_ppl.world.errors import InvalidEventError, UnknownNameError
from phase_ppl.world.hypothesis import scenario
from tests.world.examples import make_event


@pytest.fixture
def two_bundled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "events"
    folder.mkdir()
    for name in ("meet", "chase"):
        save_event(make_event(id=name), folder / f"{name}.json")
    (folder / "README.md").write_text("not an event")
    monkeypatch.setattr(load, "_folder", lambda: folder)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")


@pytest.mark.usefixtures("two_bundled")
def test_a_bundled_event_is_loaded_by_its_name_unless_a_file_has_it() -> None:
    assert bundled_events() == ["chase", "meet"]
    assert load_event("meet").id == "meet"
    for name in ("chase", "chase.json", Path("chase.json")):
        assert load_event(name).id == load_events(name)[0].id == "chase"
    assert load_event("chase", turning="cw").scene.turning == "cw"
    save_event(make_event(id="my own"), "chase.json")
    Path("chase").mkdir()
    assert (load_event("chase.json").id, load_event("chase").id) == ("my own", "chase")


@pytest.mark.usefixtures("two_bundled")
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("results", "results: is a folder"),
        ("data/chase.json", r"data/chase.json: no such file"),
        ("chasing", r"chasing: no such file .* \(chase, meet\)"),
    ],
)
def test_nothing_else_stands_for_a_bundled_event(name: str, said: str) -> None:
    Path("results").mkdir()
    with pytest.raises(InvalidEventError, match=said):
        load_event(name)
    with pytest.raises(UnknownNameError, match="chase: unknown video 'other'"):
        load_event("chase", video="other")


@pytest.mark.parametrize("name", bundled_events())
def test_every_bundled_event_carries_its_name_and_a_consistent_truth(name: str) -> None:
    event = load_event(name)
    assert event.id == name
    assert event.truth is not None
    assert event.truth.scenario == scenario(event.truth.goal_red, event.truth.goal_green)
