"""Pickles of plain data are read; all else that a pickle asks for is refused, and never run."""

from __future__ import annotations

import collections
import os
import pickle
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.data import authors
from phase_ppl.data.authors import read_pickle, unpickled
from phase_ppl.world.errors import InvalidEventError
from tests.data.authors.pickles import processed

SPRUNG = "PHASE_PPL_TEST_TRAP"
"""A folder, or a variable of the environment, that is there once code of a pickle has run."""

F8 = b"cnumpy\ndtype\nVf8\nI00\nI01\n\x87R(K\x03V<\nNNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
EMPTY = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
EIGHT = b"C\x08" + bytes(8)


class Trap:
    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> tuple[Any, ...]:
        return self.call


def is_sprung() -> bool:
    return SPRUNG in os.environ or Path(SPRUNG).exists()


def complaint(content: bytes) -> str | None:
    """Return the one line with which a pickle is refused; None where it is read."""
    try:
        unpickled(content)
    except InvalidEventError as error:
        message = str(error)
    else:
        return None
    assert "\n" not in message
    assert len(message) < 250
    return message


def refused(content: bytes) -> str:
    message = complaint(content)
    assert message is not None
    return message


def array(shape: bytes, dtype: bytes = F8, content: bytes = EIGHT) -> bytes:
    """Return the pickle of an array in parts: (1, shape, dtype, False, content)."""
    return EMPTY + b"(K\x01" + shape + dtype + b"\x89" + content + b"tb."


PROTOCOLS = (0, 2, pickle.HIGHEST_PROTOCOL)


@pytest.fixture(autouse=True)
def _nothing_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    yield
    assert not is_sprung()


def assert_read(content: bytes, value: Any) -> None:
    assert repr(unpickled(content)) == repr(value)  # which tells lists from tuples, and 1 from True


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False)
    | st.text(max_size=300) | st.binary(max_size=300),
    lambda inner: st.lists(inner, max_size=5) | st.lists(inner, max_size=5).map(tuple)
    | st.dictionaries(st.text(max_size=5) | st.integers(-9, 9), inner, max_size=5),
    max_leaves=20,
)  # fmt: skip


@settings(max_examples=100)
@given(value=plain, protocol=st.sampled_from(PROTOCOLS))
def test_plain_data_are_read_as_they_were(value: Any, protocol: int) -> None:
    assert_read(pickle.dumps(value, protocol), value)


ARRAYS = [
    *(np.arange(3.0), np.arange(6).reshape(2, 3).T, np.arange(12.0).reshape(3, 4)[:, ::2]),
    np.arange(24, dtype=np.float32).reshape(2, 3, 4).transpose(1, 0, 2),
    *(np.array([True, False]), np.arange(3, dtype=">f8"), np.array([-1, 0, 1], np.int16)),
    *(np.zeros((0, 5)), np.array(4.5)),
]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_arrays_and_numbers_are_read_as_they_were_and_what_is_shared_too(protocol: int) -> None:
    for one, back in zip(ARRAYS, unpickled(pickle.dumps(ARRAYS, protocol)), strict=True):
        np.testing.assert_array_equal(one, back)
        assert one.dtype == back.dtype.newbyteorder(one.dtype.byteorder)
    numbers = [np.float64(0.1), np.int32(-7), np.uint8(200), np.bool_(True), np.float32(0.5)]
    assert_read(pickle.dumps(numbers, protocol), [0.1, -7, 200, True, 0.5])
    goal, array = ["LMO", 0, 1, 1], np.arange(4.0)
    shared = {"one": [goal, array], "two": [goal, array], (0, "x"): (goal, goal)}
    assert_read(pickle.dumps(shared, protocol), shared)


OLD = (
    b"(dp0\nS'name'\np1\nS'a\\n\\'b\\\\'\np2\nsS'long'\np3\nL5L\nsS'yes'\nI01\nsS'track'\np4\n"
    b"cnumpy.core.multiarray\n_reconstruct\np5\n(cnumpy\nndarray\np6\n(I0\ntp7\nS'b'\np8\ntp9\n"
    b"Rp10\n(I1\n(I2\ntp11\ncnumpy\ndtype\np12\n(S'f8'\np13\nI0\nI1\ntp14\nRp15\n(I3\nS'<'\np16\n"
    b"NNNI-1\nI-1\nI0\ntp17\nbI00\nS'\\x00\\x00\\x00\\x00\\x00\\x00\\xf0?\x9a\x99\x99\x99\x99\x99"
    b"\xb9?'\np18\ntp19\nbs."
)
OLD_BINARY = (
    b"\x80\x02cnumpy.core.multiarray\n_reconstruct\nq\x00cnumpy\nndarray\nq\x01K\x00\x85U\x01b\x87"
    b"R(K\x01K\x02\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff"
    b"\xff\xff\xffK\x00tb\x89U\x10\x00\x00\x00\x00\x00\x00\xf0?\x9a\x99\x99\x99\x99\x99\xb9?tb."
)


def test_pickles_of_python_2_are_read() -> None:
    value = {"name": "a\n'b\\", "long": 5, "yes": True, "track": np.array([1.0, 0.1])}
    assert_read(OLD, value)
    assert_read(OLD_BINARY, np.array([1.0, 0.1]))
    # which wrote bytes as texts of 256 characters
    assert unpickled(b"S'\\xe9\xe9'\n.") == "éé"
    assert unpickled(b"U\x02\xe9\xff.") == "éÿ"


class Own:
    def __init__(self) -> None:
        self.x = 1


class OwnArray(np.ndarray):
    pass


SET = f"__import__('os').environ.__setitem__({SPRUNG!r}, '1')"
OBJECTS: dict[str, list[Any]] = {
    "asks for 'posix.mkdir'": [Trap(os.mkdir, SPRUNG), [1, {"a": [Trap(os.mkdir, SPRUNG)]}]],
    "', which is refused": [
        *(Trap(os.system, f"mkdir {SPRUNG}"), Trap(eval, SET), Trap(exec, SET), Own, np.mean),
        *(Trap(getattr, "x", "upper"), Trap(__import__, "os"), Trap(pickle.loads, b"N.")),
        *(Trap(np.load, "x.npy"), Trap(np.memmap, "x"), range(3), 1j, collections.OrderedDict(a=1)),
    ],
    "refused": [Own(), {1, 2}, frozenset((1,)), [bytearray(b"ab"), Own()],
                np.arange(3.0).view(OwnArray), np.ma.array([1.0], mask=[True])],
    "something else than plain numbers": [
        np.array([Trap(os.mkdir, SPRUNG)], object), np.array([1, "a", None], object),
        np.array(["a", "b"]), *(np.zeros(2, kind) for kind in ([("a", "f8")], "M8[s]", complex)),
    ],
    "a function or a class in place of data": [np.dtype("f8")],
}  # fmt: skip


@pytest.mark.parametrize("message", OBJECTS)
def test_objects_are_refused(message: str) -> None:
    for value in OBJECTS[message]:
        for protocol in PROTOCOLS:
            assert message in refused(pickle.dumps(value, protocol))


def test_the_traps_work() -> None:
    pickle.loads(pickle.dumps(Trap(os.mkdir, SPRUNG)))
    assert is_sprung()
    os.rmdir(SPRUNG)
    pickle.loads(pickle.dumps(Trap(eval, SET)))
    assert is_sprung()
    del os.environ[SPRUNG]


def text(value: str) -> bytes:
    return b"\x8c" + bytes([len(value)]) + value.encode()


def long(value: int) -> bytes:
    return b"L%dL\n" % value


def from_buffer(*arguments: bytes) -> bytes:
    return b"cnumpy._core.numeric\n_frombuffer\n(" + b"".join(arguments) + b"tR."


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

REFUSED: dict[str, list[bytes]] = {
    "asks for": [
        b"cnumpy.core.multiarray\n_reconstruct.__globals__\n.", b"cnumpy\nos\n.",
        b"\x80\x04" + text("numpy") + text("ndarray.__reduce__") + b"\x93.",
        b"ccopy_reg\n_reconstructor\n.", b"c" + b"x" * 5000 + b"\ny\n.",
        b"cphase_ppl.data.authors\n_Reader\n.",
    ],
    # an object of a class, a number that stands for one, something outside the file, a set
    "is damaged, or holds an object of a class, refused": [
        b"(S'x'\nios\nsystem\n.", b"(cnumpy\nndarray\nS'x'\no.",
        b"\x80\x02cnumpy\nndarray\n)\x81.", b"\x80\x04cnumpy\nndarray\n)}\x92.",
        b"\x80\x02\x82\x01.", b"\x80\x02\x83\x01\x00.", b"\x80\x02\x84\x01\x00\x00\x00.",
        b"Pother\n.", b"K\x01Q.", b"\x80\x05\x97.", b"\x80\x05C\x01a\x98.", b"\x80\x04\x8f.",
        b"\xfe.",
    ],
    "a function or a class in place of data": [
        b"c_codecs\nencode\n.", b"]cnumpy\nndarray\na.",
    ],
    "sets the state of what is no array": [
        b"c_codecs\nencode\n}b.", b"c_codecs\nencode\n}Vx\nK\x01sb0N.", b"}}b.",
        b"cnumpy\nndarray\n}b.", b"}" + b")" + b"\x85Nb" * DEEP + b"Ns.",
    ],
    "something else than plain numbers": [
        b"cnumpy\ndtype\ncnumpy\nndarray\n\x85R.", b"cnumpy\ndtype\n](]e\x85R.",
        array(b"K\x01\x85", b"Vf8\n"), array(b"K\x01\x85", content=b"](Ne"),
        array(b"K\x01\x85", content=EMPTY), EMPTY + b"(" + b"N" * 10 + b"tb.",
        b"cnumpy\ndtype\nVf8\n\x85R(K\x03V<\nNVx\nNK\x00K\x00K\x00tb.",
        b"cnumpy\ndtype\nVf8\n\x85R(K\x03VX\nNNNK\x00K\x00K\x00tb.",
        b"c_codecs\nencode\nK\x01Vlatin1\n\x86R.",
    ],
    "an impossible shape": [
        array(shape) for shape in (
            long(2**60) + b"\x85", long(-1) + b"\x85", long(-1) + long(-1) + b"\x86", b"F1.0\n\x85",
            b"I01\n\x85", b"](K\x01e", b"(" + long(2**40) + b"K\x00t",
            b"(" + long(2**31) * 8 + b"t",
        )
    ],
    "in 8 bytes": [array(long(2**30) + b"\x85")],
    "in 16 bytes": [array(b"K\x01\x85", content=b"C\x10" + bytes(16))],
    "in 2 bytes": [b"cnumpy.core.multiarray\nscalar\n" + F8 + b"C\x02ab\x86R."],
    # small files that become large, or take for ever
    "is larger than": [
        laughs(60), laughs(12, MANY), laughs(9, LONG),
        b"](" + LONG + b"q\x00" + b"}h\x00Ns" * 30 + b"e.",
    ],
    "becomes too large": [
        b"(" + LONG + b"q\x00c_codecs\nencode\nq\x01" + b"h\x01h\x00Vlatin1\n\x86R0" * 300 + b"t.",
        b"X" + struct.pack("<I", 8 * 10**6) + b"\0" * 8 * 10**6 + b"q\x00(" + 40 * (
            EMPTY + b"(K\x01J" + struct.pack("<i", 10**6) + b"\x85" + F8 + b"\x89h\x00tb"
        ) + b"t.",
    ],
    "nested more than 64 deep, or in itself": [
        b"]q\x00h\x00a.", b"}q\x00Vx\nh\x00s.", b"]q\x00h\x00\x85a.",
        b"]" * DEEP + b"a" * (DEEP - 1) + b".", b")" + b"\x85" * DEEP + b".",
        b"Nq\x000" + b"(Vx\nh\x00dq\x000" * DEEP + b"h\x00.",
    ],
    "keys are no texts or whole numbers": [
        b"}K\x01\x85\x85Ns.", b"}(NNK\x01\x85\x85Nu.", b"(K\x01\x85\x85Nd.", b"]NNs.",
        # each of which would take 2 ** 60 steps to hash, or overflow the stack of C
        b"}N\x85" + b"2\x86" * 60 + b"Ns.", b"}" + b")" + b"\x85" * DEEP + b"Ns.",
        b"}K\x01\x85q\x00" + b"0(h\x00h\x00tq\x00" * 60 + b"Ns.",
        b"}(" + b"K\x01" * 50 + b"tNs.", b"}Fnan\nNs.", b"}]Ns.",
        b"}\x8b" + struct.pack("<i", 10**6) + b"\x7f" * 10**6 + b"Ns.",
    ],
    # no pickle, or a damaged one
    "is empty": [b""],
    "refused": [b"PK\x03\x04\x14\x00\x00\x00"],
    "is damaged": [
        b'{"format": "x"}', b"hello world", b"c\xff\n\xfe\n.", b"\x80\x06N.",
        *(array(b"K\x01\x85", content=b"V\\u0394\n"), EMPTY + b"K\x01\x85b.", EMPTY + b"}b."),
        b"c_codecs\nencode\nVab\nVrot13\n\x86R.", b"c_codecs\nencode\nV\\u0394\nVlatin1\n\x86R.",
        b"c__builtin__\nbytes\nK\x05\x85R.", b"cnumpy.core.multiarray\n_reconstruct\n)R.",
        b"cnumpy.core.multiarray\n_reconstruct\nNK\x00\x85C\x01b\x87R.", b"cnumpy\ndtype\n)R.",
        b"cnumpy.core.multiarray\nscalar\n" + F8 + b"\x85R.", from_buffer(EIGHT, F8),
        from_buffer(EIGHT, F8, b"K\x01\x85", b"VK\n", b"K\x00K\x00\x86"),
        b"X\x01\x00\x00\x00\xff.", b"V\\uZZZZ\n.", b"Iabc\n.", b"L" + b"9" * 100_000 + b"L\n.",
        b"\x80\x04\x8e" + b"\xff" * 8 + b"x.", b"\x80\x04\x8d" + struct.pack("<Q", 2**40) + b"x.",
        b"T\xff\xff\xff\xffx.", b"\x80\x02\x8b\xff\xff\xff\x7f.", b"\x80\x02\x8b\xff\xff\xff\xff.",
        b"\x80\x04]" + text("x") + b"\x93.", b"\x80\x04\x93.", b"]K\x01\x85R.",
        b"cnumpy\nndarray\nK\x01\x85R.", b"c_codecs\nencode\n]R.", b"(" * DEEP + b".",
        b"Nr\xff\xff\xff\xff0j\xfe\xff\xff\xff.", b"\x80\x04\x95" + b"\xff" * 8 + b"N0.", b".",
        b"Sab\n.", b"S'\n.", b"S'ab\"\n.", b"S'\\q'\n.", b"}(K\x01u.", b"(K\x01d.", b"}Na.",
        b")(Ne.",
        b"]e.", b"N\x87.", b"h\x00.", b"q\x00.", b"0.", b"2.",
    ],
}  # fmt: skip
"""Message -> pickles that get it."""


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_not_plain_data_is_refused(message: str) -> None:
    for content in REFUSED[message]:
        assert message in refused(content), content[:60]


def test_room_is_never_made_for_places_that_are_not_used() -> None:
    tracemalloc.start()
    try:
        for content in (
            b"Nr\xff\xff\xff\xff.",  # place 4294967295 of the memo
            b"Np4294967295\n.",
            b"\x80\x05\x96" + struct.pack("<Q", 2**33) + b"x.",  # so many bytes to follow
            b"\x80\x04\x8e" + struct.pack("<Q", 2**33) + b"x.",
        ):
            complaint(content)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


def test_too_much_and_nothing_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(authors, "MAX_OPCODES", 10)
    assert unpickled(b"N0" * 4 + b"N.") is None
    assert "has more than 10 opcodes" in refused(b"N0" * 5 + b"N.")
    path = tmp_path / "x.pkl"
    with pytest.raises(InvalidEventError, match="no such file"):
        read_pickle(path)
    path.write_bytes(pickle.dumps([1, 2]))
    monkeypatch.setattr(authors, "MAX_BYTES", path.stat().st_size)
    assert read_pickle(path) == [1, 2]
    monkeypatch.setattr(authors, "MAX_BYTES", path.stat().st_size - 1)
    with pytest.raises(InvalidEventError, match="is larger than the"):
        read_pickle(path)


def videos(protocol: int) -> bytes:
    video = processed(2)
    video["trajectories"] = [track[:3] for track in video["trajectories"]]
    return pickle.dumps([video], protocol)


@pytest.mark.parametrize("protocol", [0, 5])
def test_a_truncated_file_is_refused_wherever_it_ends(protocol: int) -> None:
    content = videos(protocol)
    assert len(unpickled(content)) == 1
    for end in range(len(content)):
        assert refused(content[:end])


pieces = st.sampled_from(
    [
        *(bytes([code]) for code in range(256)),
        *(b"K\x01", b"K\x00", b"V<\n", b"C\x08" + bytes(8), b"q\x00", b"h\x00", b"\x85", b"\x87"),
        *(F8, EMPTY, b"cnumpy\nndarray\n", b"cnumpy\ndtype\n", b"c_codecs\nencode\n"),
        *(b"cposix\nmkdir\n", b"V" + SPRUNG.encode() + b"\n", b"R", b"b", b"t", b"(", b"."),
    ]
)


@settings(max_examples=400)
@given(parts=st.lists(pieces, max_size=25))
def test_any_bytes_are_read_or_refused(parts: list[bytes]) -> None:
    complaint(b"".join(parts) + b".")
    assert not is_sprung()
