"""Pickles that are damaged, or that would become large, are refused in one line."""

from __future__ import annotations

import pickle
import random
import struct
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.dataset import load_events
from phase_ppl.dataset.authors import pickles
from phase_ppl.dataset.authors.pickles import read_pickle, unpickled
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from tests.dataset.authors.pickles import name_of, processed, record
from tests.dataset.authors.test_unpickle import OLD, OLD_BINARY, PROTOCOLS
from tests.dataset.authors.traps import EMPTY, F8, SPRUNG, array, complaint, is_sprung, refused

# --- small files that become large -----------------------------------------------------------

DEEP = 100_000


def laughs(levels: int, last: bytes = b"VHa\n") -> bytes:
    """Return a list of two of the same list of two of ... the last."""
    parts = [last, b"q\x00"]
    for _ in range(levels):
        parts.append(b"0](h\x00h\x00eq\x00")
    return b"".join([*parts, b"."])


LONG = b"X" + struct.pack("<I", 1_000_000) + b"x" * 1_000_000
MANY = array(
    b"M" + struct.pack("<H", 50_000) + b"\x85",
    content=b"B" + struct.pack("<I", 400_000) + bytes(400_000),
)[:-1]
"""A text of a million characters, an array of 50,000 numbers."""

BOMBS: dict[str, tuple[bytes, str]] = {
    "laughs": (laughs(60), "is larger than"),
    "laughing_arrays": (laughs(12, MANY), "is larger than"),
    "laughing_texts": (laughs(9, LONG), "is larger than"),
    "laughing_keys": (b"](" + LONG + b"q\x00" + b"}h\x00Ns" * 30 + b"e.", "is larger than"),
    "itself": (b"]q\x00h\x00a.", "nested more than 64 deep, or in itself"),
    "dict_itself": (b"}q\x00Vx\nh\x00s.", "nested more than 64 deep, or in itself"),
    "tuple_itself": (b"]q\x00h\x00\x85a.", "nested more than 64 deep, or in itself"),
    "lists": (b"]" * DEEP + b"a" * (DEEP - 1) + b".", "nested more than 64 deep"),
    "tuples": (b")" + b"\x85" * DEEP + b".", "nested more than 64 deep"),
    "dicts": (b"Nq\x000" + b"(Vx\nh\x00dq\x000" * DEEP + b"h\x00.", "nested more than 64 deep"),
    "tuple_key": (b"}" + b")" + b"\x85" * DEEP + b"Ns.", "nested more than 64 deep"),
    "nested_key": (b"}K\x01\x85\x85Ns.", "keys are no texts or whole numbers"),
    "nested_keys": (b"}(NNK\x01\x85\x85Nu.", "keys are no texts or whole numbers"),
    "nested_key_of_dict": (b"(K\x01\x85\x85Nd.", "keys are no texts or whole numbers"),
    # each of which would take 2 ** 60 steps to hash, or overflow the stack of C
    "doubled_key": (b"}N\x85" + b"2\x86" * 60 + b"Ns.", "keys are no texts or whole numbers"),
    "doubled_by_memo": (
        b"}K\x01\x85q\x00" + b"0(h\x00h\x00tq\x00" * 60 + b"Ns.",
        "keys are no texts or whole numbers",
    ),
    "key_that_was_built": (b"}" + b")" + b"\x85Nb" * DEEP + b"Ns.", "nested more than 64 deep"),
    "long_key": (b"}(" + b"K\x01" * 50 + b"tNs.", "keys are no texts or whole numbers"),
    "nan_key": (b"}Fnan\nNs.", "keys are no texts or whole numbers"),
    "list_key": (b"}]Ns.", "keys are no texts or whole numbers"),
    "marks": (b"(" * DEEP + b".", "makes no sense"),
    "place": (b"Nr\xff\xff\xff\xff0j\xfe\xff\xff\xff.", "makes no sense"),
    "bytes": (b"\x80\x04\x8e" + b"\xff" * 8 + b"x.", "ends too early"),
    "text": (b"\x80\x04\x8d" + struct.pack("<Q", 2**40) + b"x.", "ends too early"),
    "old_text": (b"T\xff\xff\xff\xffx.", "ends too early"),
    "bytearray": (b"\x80\x05\x96" + struct.pack("<Q", 2**62) + b"x.", "ends too early"),
    "frame": (b"\x80\x04\x95" + b"\xff" * 8 + b"N0.", "makes no sense"),
    "long": (b"\x80\x02\x8b\xff\xff\xff\x7f.", "ends too early"),
    "negative_long": (b"\x80\x02\x8b\xff\xff\xff\xff.", "LONG4 at byte 2 says cannot be"),
    "wide": (b"\x80\x02\x8a\x09" + b"\xff" * 8 + b"\x7f.", "more than 64 bits"),
    "digits": (b"I" + b"9" * 30 + b"\n.", "more than 64 bits"),
    "more_digits": (b"L" + b"9" * 100_000 + b"L\n.", "LONG at byte 0"),
    "long_long": (b"\x80\x02\x8b" + struct.pack("<i", 10**6) + b"\x7f" * 10**6 + b".", "64 bits"),
    "frame_of_much": (b"\x80\x04\x95" + struct.pack("<Q", 2**50) + b"N.", "makes no sense"),
    "conversions": (
        b"(" + LONG + b"q\x00c_codecs\nencode\nq\x01" + b"h\x01h\x00Vlatin1\n\x86R0" * 300 + b"t.",
        "becomes too large",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BOMBS)
def test_a_small_file_never_becomes_large(case: str) -> None:
    content, message = BOMBS[case]
    assert message in refused(content)


def test_room_is_never_made_for_places_that_are_not_used() -> None:
    tracemalloc.start()
    try:
        for content in (
            b"Nr\xff\xff\xff\xff.",  # place 4294967295 of the memo
            b"Np4294967295\n.",
            b"\x80\x05\x96" + struct.pack("<Q", 2**33) + b"x.",  # so many bytes to follow
            b"\x80\x04\x8e" + struct.pack("<Q", 2**33) + b"x.",
        ):
            refused(content)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


def test_nesting_is_counted_where_parts_are_shared_too() -> None:
    chain = b"]q\x00" + b"0](h\x00eq\x00" * 40
    assert "nested" in refused(chain + b"0](h\x00" + b"](" * 40 + b"h\x00" + b"e" * 41 + b".")


def test_too_many_opcodes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pickles, "MAX_OPCODES", 10)
    assert unpickled(b"N0" * 4 + b"N.") is None
    assert "has more than 10 opcodes" in refused(b"N0" * 5 + b"N.")


def test_a_file_that_is_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps(list(range(100))))
    monkeypatch.setattr(pickles, "MAX_BYTES", path.stat().st_size)
    assert read_pickle(path) == list(range(100))
    monkeypatch.setattr(pickles, "MAX_BYTES", path.stat().st_size - 1)
    with pytest.raises(InvalidEventError, match="is larger than the"):
        read_pickle(path)


# --- damage ----------------------------------------------------------------------------------

DAMAGED: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "is empty"),
    "json": (b'{"format": "x"}', "is damaged"),
    "words": (b"hello world", "is damaged"),
    "zip": (b"PK\x03\x04\x14\x00\x00\x00", "refused"),
    "nothing": (b".", "makes no sense"),
    "two": (b"NN.", "makes no sense"),
    "open": (b"(N.", "makes no sense"),
    "more": (b"N.N.", "goes on after the end"),
    "protocol": (b"\x80\x06N.", "protocol 6, expected at most 5"),
    "opcode": (b"\xfe.", r"unknown opcode b'\xfe'"),
    "quotes": (b"Sab\n.", "makes no sense"),
    "one_quote": (b"S'\n.", "makes no sense"),
    "other_quote": (b"S'ab\"\n.", "makes no sense"),
    "escape": (b"S'\\q'\n.", "makes no sense"),
    "many_escapes": (b"S'" + b"\\x41" * 50_000 + b"\\'\n.", "makes no sense"),
    "utf8": (b"X\x01\x00\x00\x00\xff.", "BINUNICODE at byte 0"),
    "raw_unicode": (b"V\\uZZZZ\n.", "UNICODE at byte 0"),
    "word": (b"Iabc\n.", "INT at byte 0"),
    "odd_items": (b"}(K\x01u.", "makes no sense"),
    "odd_dict": (b"(K\x01d.", "makes no sense"),
    "append": (b"}Na.", "makes no sense"),
    "extend": (b")(Ne.", "makes no sense"),
    "items": (b"]NNs.", "makes no sense"),
    "no_mark": (b"]e.", "makes no sense"),
    "tuple": (b"N\x87.", "makes no sense"),
    "get": (b"h\x00.", "makes no sense"),
    "put": (b"q\x00.", "makes no sense"),
    "pop": (b"0.", "makes no sense"),
    "copy": (b"2.", "makes no sense"),
    "under_mark": (b"N(0.", "makes no sense"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_what_is_no_pickle_is_refused(case: str) -> None:
    content, message = DAMAGED[case]
    assert message in refused(content)


def videos(protocol: int) -> bytes:
    video = processed(2)
    video["trajectories"] = [track[:3] for track in video["trajectories"]]
    return pickle.dumps([video], protocol)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_truncated_file_is_refused_wherever_it_ends(protocol: int) -> None:
    content = videos(protocol)
    assert len(unpickled(content)) == 1
    for end in range(len(content)):
        assert refused(content[:end])


WHOLE = [*(videos(protocol) for protocol in PROTOCOLS), OLD, OLD_BINARY]


@pytest.mark.parametrize("content", WHOLE, ids=[*map(str, PROTOCOLS), "old", "old_binary"])
def test_a_damaged_file_is_read_or_refused(content: bytes) -> None:
    rng = random.Random(len(content))
    found = [complaint(damaged(content, rng)) for _ in range(700)]
    assert not is_sprung()
    assert None in found
    assert len(set(found)) > 5


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Return ``content`` with a few bytes replaced."""
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_damaged_file_holds_events_or_none(tmp_path: Path, protocol: int) -> None:
    rng = random.Random(protocol)
    files = {"videos.pkl": [processed(2)], f"{name_of(3)}.pik": record(3)}
    for name, content in files.items():
        path = tmp_path / name
        for _ in range(30):
            path.write_bytes(damaged(pickle.dumps(content, protocol), rng))
            try:
                said = f"{path}: {len(load_events(path, format='phase-pickle'))} event"
            except PhasePPLError as error:
                said = str(error)
            assert said.startswith(str(path))
            assert "\n" not in said
    assert not is_sprung()


OPCODES = [bytes([code]) for code in range(256)]
pieces = st.sampled_from(
    [
        *OPCODES,
        *(b"K\x01", b"K\x00", b"V<\n", b"C\x08" + bytes(8), b"q\x00", b"h\x00", b"\x85", b"\x87"),
        *(F8, EMPTY, b"cnumpy\nndarray\n", b"cnumpy\ndtype\n", b"c_codecs\nencode\n"),
        *(b"cposix\nmkdir\n", b"V" + SPRUNG.encode() + b"\n", b"R", b"b", b"t", b"(", b"."),
    ]
)  # fmt: skip


@settings(max_examples=1000, deadline=None)
@given(parts=st.lists(pieces, max_size=25))
def test_any_bytes_are_read_or_refused(parts: list[bytes]) -> None:
    complaint(b"".join(parts) + b".")
    assert not is_sprung()


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidEventError, match="no such file"):
        read_pickle(tmp_path / "none.pkl")
    with pytest.raises(InvalidEventError, match="is a folder"):
        read_pickle(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(InvalidEventError, match="cannot be read: Not a directory"):
        read_pickle(tmp_path / "file" / "x")
