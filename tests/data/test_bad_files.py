"""Whatever is offered as an event: either an event, or one line that says why not."""

from __future__ import annotations

import json
import math
import os
import pickle
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phase_ppl.data import documents
from phase_ppl.data.documents import parse_document
from phase_ppl.data.events_json import event_record
from phase_ppl.data.load import load_event, load_events, save_event
from phase_ppl.world.errors import InvalidEventError, PhasePPLError, UnknownNameError
from tests.data.authors.test_unpickle import Trap
from tests.data.test_phase_test import put, video, write
from tests.world.examples import make_event


def refused(path: Path | str, error: type[Exception] = InvalidEventError) -> str:
    with pytest.raises(error) as raised:
        load_event(path)
    with pytest.raises(error):
        load_events(path)
    message = str(raised.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


@pytest.mark.parametrize("protocol", [0, 2, pickle.HIGHEST_PROTOCOL])
def test_other_pickles_are_refused_without_running_them(tmp_path: Path, protocol: int) -> None:
    for content, why in (
        (Trap(os.mkdir, str(tmp_path / "sprung")), f"asks for '{os.mkdir.__module__}.mkdir'"),
        ({"format": "phase-ppl-event-1"}, "videos: Expected 'array', got 'object'"),
        (["videos"], "videos[0]: Expected 'object', got 'str'"),
    ):
        for name in ("event.pkl", "event.json", "event"):
            path = tmp_path / name
            path.write_bytes(pickle.dumps(content, protocol))
            said = refused(path)
            assert "is a pickle (only pickles of PHASE's authors can be read): " in said
            assert why in said
    assert not (tmp_path / "sprung").exists()


def test_a_pickle_in_place_of_another_document_is_not_loaded(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_bytes(pickle.dumps(Trap(os.mkdir, str(tmp_path / "sprung"))))
    with pytest.raises(InvalidEventError, match=r"manifest\.json: is not JSON"):
        load_events(tmp_path)
    assert not (tmp_path / "sprung").exists()


FILES: list[tuple[bytes, str]] = [
    (b"", "is empty"),
    (b"hello world", "is not JSON: line 1: JSON is malformed: invalid character (byte 0)"),
    (b'{"id": "x", "scene": [', "is not JSON: line 1: Input data was truncated"),
    ('{"id": "Mädchen"}'.encode("latin-1"), "is no text in UTF-8"),
    (b"[1, 2, 3]", "is no JSON object: Expected `object`, got `array`"),
    (b'{"id": "x"}', "is no event file: it has no format"),
    (b'{"format": "phase-replays-1"}', "has format 'phase-replays-1', expected"),
    (b'{"format": "phase-ppl-event-1", "id": NaN}', "is not JSON: line 1: "),
    (b'{"format": 1e999}', "Number out of range"),
    (b'{"format": ' + b"9" * 5000 + b"}", "Integer value out of range"),
    (b'{"format": "x", "format": "y"}', "holds an object with two fields 'format'"),
    (b'{"a":' * 100_000, "nested too deeply"),
    (b'{"format": "phase-ppl-event-1"}', "id is None, expected printable text"),
    (b'{"format": "phase-ppl-events-1", "events": {}}', "events: Expected 'array', got 'object'"),
    (b'{"format": "phase-ppl-events-1", "events": []}', "the list is empty"),
    (b'{"format": "phase-ppl-events-1", "events": [3]}', "events[0]: Expected 'object', got 'int'"),
    (b'{"format": "phase-test-1"}', "missing required field"),
]


def test_a_file_that_is_no_event_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "event.json"
    for content, message in FILES:
        path.write_bytes(content)
        assert message in refused(path)
    assert "holds two videos with the id 'v1'" in refused(write(tmp_path, video(), video()))


def test_a_posterior_in_place_of_an_event_is_sent_to_its_reader(tmp_path: Path) -> None:
    path = tmp_path / "posterior.nc"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(InvalidEventError, match=r"posterior.nc: is NetCDF.*load_posterior"):
        load_event(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    assert "no such file" in refused(tmp_path / "none.json")
    (tmp_path / "folder.json").mkdir()
    assert "is a folder, expected an event file" in refused(tmp_path / "folder.json")
    (tmp_path / "file").touch()
    assert "cannot be read: Not a directory" in refused(tmp_path / "file" / "x.json")


def test_a_byte_order_mark_does_no_harm_and_too_much_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "large.json"
    save_event(make_event(), path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    monkeypatch.setattr(documents, "MAX_BYTES", path.stat().st_size)
    assert load_event(path).id == "example"
    monkeypatch.setattr(documents, "MAX_BYTES", path.stat().st_size - 1)
    assert "is larger than" in refused(path)


RED = ("trajectories", "red agent")
VALUES: list[tuple[tuple[str | int, ...], Any, str]] = [
    (("trajectories",), None, "trajectories: Expected 'object', got 'null'"),
    (("trajectories",), {}, "trajectories has no red agent and no green agent and"),
    (("trajectories", "blue item"), [[12.0, 8.0, 0.0]] * 3,
     "trajectories differ in length: 4 red agent, 4 green agent, 3 blue item, 4 pink item"),
    ((*RED, 2), [8.0, 20.0], "trajectories['red agent'][2]: Expected 'array' of length 3, got 2"),
    (("scene", "arena", "x"), [6.0], "scene.arena.x: Expected 'array' of length 2, got 1"),
    (("truth", "strengths", "red agent"), "strong",
     "truth.strengths['red agent']: Expected 'float | null'"),
    (("truth", "goals"), {}, "truth.goals has no red agent and no green agent"),
    (("scene", "resets_velocity"), 1, "scene.resets_velocity: Expected 'bool', got 'int'"),
]  # fmt: skip
NAMES: list[tuple[tuple[str | int, ...], Any, str]] = [
    (("scene", "turning"), "left", "unknown turning 'left'; allowed: 'both', 'ccw'"),
    (("trajectories", "blue ball"), [], "unknown field of trajectories 'blue ball'"),
    (("turnin",), "cw", "unknown field of an event 'turnin'"),
    (("scene", "radius", "turnin"), "cw", "unknown field of scene.radius 'turnin'"),
]


@pytest.mark.parametrize(
    ("cases", "error"), [(VALUES, InvalidEventError), (NAMES, UnknownNameError)]
)
def test_a_wrong_value_is_named_with_the_file(
    tmp_path: Path, cases: list[tuple[tuple[str | int, ...], Any, str]], error: type[Exception]
) -> None:
    path = tmp_path / "event.json"
    for where, value, message in cases:
        record = event_record(make_event(id="event"))
        put(record, where, value)
        path.write_text(json.dumps(record))
        assert message in refused(path, error)


odd_values = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 30),
    st.sampled_from([math.nan, math.inf, 1e300, -1e300, 10**30, 10**320]),
    st.sampled_from(["", "red agent", "both", "8.0", "\ud800", "phase-test-1"]),
    st.sampled_from([[], {}, [[]], [[1, 2], [3]], [{}], {"x": [1, 2]}, [[[16, 12], [16, 22]]]]),
)


def nodes(value: Any) -> list[tuple[Any, Any]]:
    """Return every (container, key) in a JSON value."""
    keys = list(value) if isinstance(value, dict) else range(len(value))
    found = []
    for key in keys:
        found.append((value, key))
        if isinstance(value[key], (dict, list)):
            found.extend(nodes(value[key]))
    return found


@settings(max_examples=80, suppress_health_check=list(HealthCheck))
@given(own=st.booleans(), data=st.data())
def test_a_damaged_file_is_read_or_refused(tmp_path: Path, own: bool, data: st.DataObject) -> None:
    if own:
        document: Any = event_record(make_event(id="v1"))
    else:
        document = json.loads(write(tmp_path, video()).read_text())
    places = nodes(document)
    container, key = places[data.draw(st.integers(0, len(places) - 1))]
    if data.draw(st.booleans()):
        container[key] = data.draw(odd_values)
    else:
        del container[key]
    path = tmp_path / "damaged.json"
    path.write_text(json.dumps(document))
    try:
        event = load_event(path)
    except PhasePPLError as error:
        complaint = str(error)
    else:
        complaint = str(path)
        save_event(event, tmp_path / "again.json")
        assert load_event(tmp_path / "again.json").id == event.id
    assert str(path) in complaint
    assert "\n" not in complaint


def test_names_given_twice_are_found_in_any_number_of_them() -> None:
    # compared each with each, these would take minutes
    names = [f'"{n}": 0' for n in range(50_000)]
    with pytest.raises(InvalidEventError, match="two fields '49999'"):
        parse_document("{" + ", ".join([*names, '"49999": 1']) + "}")
