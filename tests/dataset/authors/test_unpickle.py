"""Pickles of plain data are read; all else that a pickle asks for is refused, and never run."""

from __future__ import annotations

import collections
import copyreg
import os
import pickle
import random
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.dataset.authors import pickles
from phase_ppl.dataset.authors.pickles import read_pickle, unpickled
from phase_ppl.dataset.load import load_events
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from tests.dataset.authors.pickles import name_of, processed, record

SPRUNG = "PHASE_PPL_TEST_TRAP"
"""A folder, or a variable of the environment, that is there once code of a pickle has run."""

F8 = b"cnumpy\ndtype\nVf8\nI00\nI01\n\x87R(K\x03V<\nNNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
EMPTY = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
EIGHT = b"C\x08" + bytes(8)


class Trap:
    """Its pickle, when loaded, calls a function."""

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


PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)


@pytest.fixture(autouse=True)
def _nothing_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    yield
    assert not is_sprung()


# --- what is read ----------------------------------------------------------------------------


def same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and np.array_equal(one, other)
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        parts = zip(one, other, strict=True)
        return type(one) is type(other) and all(same(*pair) for pair in parts)
    return type(one) is type(other) and one == other


plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text(max_size=300)
    | st.binary(max_size=300),
    lambda inner: (
        st.lists(inner, max_size=5)
        | st.lists(inner, max_size=5).map(tuple)
        | st.dictionaries(st.text(max_size=5) | st.integers(-9, 9), inner, max_size=5)
    ),
    max_leaves=20,
)


@settings(max_examples=300, deadline=None)
@given(value=plain, protocol=st.sampled_from(PROTOCOLS))
def test_plain_data_are_read_as_they_were(value: Any, protocol: int) -> None:
    assert same(unpickled(pickle.dumps(value, protocol)), value)


ARRAYS = [
    np.arange(3.0),
    np.arange(6).reshape(2, 3).T,
    np.arange(24, dtype=np.float32).reshape(2, 3, 4).transpose(1, 0, 2),
    np.arange(12.0).reshape(3, 4)[:, ::2],
    np.array([True, False]),
    np.arange(3, dtype=">f8"),
    np.array([-1, 0, 1], np.int16),
    np.zeros((0, 5)),
    np.array(4.5),
]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_arrays_and_numbers_are_read_as_they_were_and_what_is_shared_every_time(
    protocol: int,
) -> None:
    for one, back in zip(ARRAYS, unpickled(pickle.dumps(ARRAYS, protocol)), strict=True):
        np.testing.assert_array_equal(one, back)
        assert one.dtype == back.dtype
        assert not back.flags.writeable
    numbers = [np.float64(0.1), np.int32(-7), np.uint8(200), np.bool_(True), np.float32(0.5)]
    assert same(unpickled(pickle.dumps(numbers, protocol)), [0.1, -7, 200, True, 0.5])
    goal, array = ["LMO", 0, 1, 1], np.arange(4.0)
    shared = {"one": [goal, array], "two": [goal, array], (0, "x"): (goal, goal)}
    assert same(unpickled(pickle.dumps(shared, protocol)), shared)


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
    assert same(unpickled(OLD), value)
    assert same(unpickled(OLD_BINARY), np.array([1.0, 0.1]))
    # which wrote bytes as texts of 256 characters
    assert unpickled(b"S'\\xe9\xe9'\n.") == "éé"
    assert unpickled(b"U\x02\xe9\xff.") == "éÿ"


# --- what asks for code ----------------------------------------------------------------------


class Own:
    def __init__(self) -> None:
        self.x = 1


class OwnArray(np.ndarray):
    pass


SET = f"__import__('os').environ.__setitem__({SPRUNG!r}, '1')"
OBJECTS: dict[str, tuple[Any, str]] = {
    "system": (Trap(os.system, f"mkdir {SPRUNG}"), "asks for 'posix.system'"),
    "mkdir": (Trap(os.mkdir, SPRUNG), "asks for 'posix.mkdir'"),
    "eval": (Trap(eval, SET), "eval', which is refused"),
    "exec": (Trap(exec, SET), "exec', which is refused"),
    "getattr": (Trap(getattr, "x", "upper"), "getattr', which is refused"),
    "import": (Trap(__import__, "os"), "__import__', which is refused"),
    "load": (Trap(np.load, "x.npy"), "asks for 'numpy.load'"),
    "loads": (Trap(pickle.loads, b"N."), "loads', which is refused"),
    "fromfile": (Trap(np.memmap, "x"), "memmap', which is refused"),
    "inside": ([1, {"a": [Trap(os.mkdir, SPRUNG)]}], "asks for 'posix.mkdir'"),
    "own": (Own(), "refused"),
    "class": (Own, "Own', which is refused"),
    "function": (np.mean, "mean', which is refused"),
    "range": (range(3), "range', which is refused"),
    "complex": (1j, "complex', which is refused"),
    "set": ({1, 2}, "refused"),
    "frozenset": (frozenset((1,)), "refused"),
    "ordered": (collections.OrderedDict(a=1), "OrderedDict', which is refused"),
    "bytearray": ([bytearray(b"ab"), Own()], "refused"),
    "subclass": (np.arange(3.0).view(OwnArray), "refused"),
    "masked": (np.ma.array([1.0], mask=[True]), "refused"),
    "objects": (np.array([Trap(os.mkdir, SPRUNG)], object), "something else than plain numbers"),
    "plain_objects": (np.array([1, "a", None], object), "something else than plain numbers"),
    "texts": (np.array(["a", "b"]), "something else than plain numbers"),
    "fields": (np.zeros(2, [("a", "f8")]), "something else than plain numbers"),
    "dates": (np.zeros(2, "M8[s]"), "something else than plain numbers"),
    "complexes": (np.zeros(2, complex), "something else than plain numbers"),
    "dtype": (np.dtype("f8"), "a function or a class in place of data"),
}


@pytest.mark.parametrize("case", OBJECTS)
def test_objects_are_refused(case: str) -> None:
    value, message = OBJECTS[case]
    for protocol in PROTOCOLS:
        assert message in refused(pickle.dumps(value, protocol))


def text(value: str) -> bytes:
    return b"\x8c" + bytes([len(value)]) + value.encode()


CALLS: dict[str, tuple[bytes, str]] = {
    "dotted": (b"cnumpy.core.multiarray\n_reconstruct.__globals__\n.", "_reconstruct.__globals__"),
    "dotted_stack": (
        b"\x80\x04" + text("numpy") + text("ndarray.__reduce__") + b"\x93.",
        "asks for 'numpy.ndarray.__reduce__'",
    ),
    "module_of_numpy": (b"cnumpy\nos\n.", "asks for 'numpy.os'"),
    "our_own": (b"cphase_ppl.dataset.authors.pickles\n_Array\n.", "asks for"),
    "list_as_name": (b"\x80\x04]" + text("x") + b"\x93.", "makes no sense"),
    "no_names": (b"\x80\x04\x93.", "makes no sense"),
    "long_names": (b"c" + b"x" * 5000 + b"\ny\n.", "asks for 'xxxx"),
    "no_text": (b"c\xff\n\xfe\n.", "is damaged"),
    "instance": (b"(S'x'\nios\nsystem\n.", "holds an object of a class"),
    "object": (b"(cnumpy\nndarray\nS'x'\no.", "holds an object of a class"),
    "newobj": (b"\x80\x02cnumpy\nndarray\n)\x81.", "holds an object of a class"),
    "newobj_ex": (b"\x80\x04cnumpy\nndarray\n)}\x92.", "holds an object of a class"),
    "extension": (b"\x80\x02\x82\x01.", "a number that stands for a class"),
    "extension_2": (b"\x80\x02\x83\x01\x00.", "a number that stands for a class"),
    "extension_4": (b"\x80\x02\x84\x01\x00\x00\x00.", "a number that stands for a class"),
    "persistent": (b"Pother\n.", "a reference to something outside the file"),
    "persistent_binary": (b"K\x01Q.", "a reference to something outside the file"),
    "out_of_band": (b"\x80\x05\x97.", "a buffer outside the file"),
    "readonly": (b"\x80\x05C\x01a\x98.", "a buffer outside the file"),
    "set": (b"\x80\x04\x8f.", "holds a set"),
    "reconstructor": (b"ccopy_reg\n_reconstructor\n.", "asks for 'copy_reg._reconstructor'"),
    "call_data": (b"]K\x01\x85R.", "makes no sense"),
    "call_class": (b"cnumpy\nndarray\nK\x01\x85R.", "makes no sense"),
    "call_array": (b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\n)C\x01b\x87R)R.", ""),
    "call_list": (b"c_codecs\nencode\n]R.", "makes no sense"),
    "state_of_dict": (b"}}b.", "makes no sense"),
    "state_of_function": (b"c_codecs\nencode\n}b.", "sets the state of what is no array"),
    "state_of_class": (b"cnumpy\nndarray\n}b.", "makes no sense"),
    "function": (b"c_codecs\nencode\n.", "a function or a class in place of data"),
    "nested_class": (b"]cnumpy\nndarray\na.", "a function or a class in place of data"),
    "other_codec": (b"c_codecs\nencode\nVab\nVrot13\n\x86R.", "as NumPy never does"),
    "codec_of_data": (b"c_codecs\nencode\nK\x01Vlatin1\n\x86R.", "as NumPy never does"),
    "codec_of_others": (b"c_codecs\nencode\nV\\u0394\nVlatin1\n\x86R.", "as NumPy never does"),
    "bytes_of": (b"c__builtin__\nbytes\nK\x05\x85R.", "as NumPy never does"),
    "no_class": (b"cnumpy.core.multiarray\n_reconstruct\n)R.", "as NumPy never does"),
    "other_class": (
        b"cnumpy.core.multiarray\n_reconstruct\nNK\x00\x85C\x01b\x87R.",
        "as NumPy never does",
    ),
    "dtype_of_class": (b"cnumpy\ndtype\ncnumpy\nndarray\n\x85R.", "something else than plain"),
    "dtype_of_list": (b"cnumpy\ndtype\n](]e\x85R.", "something else than plain"),
    "dtype_empty": (b"cnumpy\ndtype\n)R.", "something else than plain"),
}


def test_a_stand_in_keeps_nothing_that_a_file_tells_it() -> None:
    told = b"c_codecs\nencode\n}Vx\nK\x01sb0"
    assert "sets the state" in refused(told + b"N.")
    assert unpickled(b"c_codecs\nencode\n(VA\nVlatin1\ntR.") == b"A"


def test_an_extension_that_python_knows_is_refused_too() -> None:
    copyreg.add_extension("os", "mkdir", 200)
    try:
        content = b"\x80\x02\x82\xc8V" + SPRUNG.encode() + b"\n\x85R."
        assert "a number that stands for a class" in refused(content)
    finally:
        copyreg.remove_extension("os", "mkdir", 200)


# --- arrays that cannot be -------------------------------------------------------------------


def long(value: int) -> bytes:
    return b"L%dL\n" % value


def from_buffer(*arguments: bytes) -> bytes:
    return b"cnumpy._core.numeric\n_frombuffer\n(" + b"".join(arguments) + b"tR."


STATES: dict[str, tuple[bytes, str]] = {
    "huge": (array(long(2**30) + b"\x85"), "in 8 bytes, expected 8589934592"),
    "huger": (array(long(2**60) + b"\x85"), "an impossible shape"),
    "product": (array(b"(" + long(2**31) * 8 + b"t"), "in 8 bytes, expected"),
    "nothing_of_much": (
        array(b"(" + long(2**40) + b"K\x00t", content=b"C\x00"),
        "impossible",
    ),
    "negative": (array(long(-1) + b"\x85"), "an impossible shape"),
    "two_negative": (array(long(-1) + long(-1) + b"\x86"), "an impossible shape"),
    "fraction": (array(b"F1.0\n\x85"), "an impossible shape"),
    "true": (array(b"I01\n\x85"), "an impossible shape"),
    "dimensions": (array(b"(" + b"K\x01" * 9 + b"t"), "an impossible shape"),
    "list": (array(b"](K\x01e"), "an impossible shape"),
    "too_much": (
        array(b"K\x01\x85", content=b"C\x10" + bytes(16)),
        "in 16 bytes, expected 8",
    ),
    "no_dtype": (array(b"K\x01\x85", b"Vf8\n"), "something else than plain numbers"),
    "objects": (array(b"K\x01\x85", content=b"](Ne"), "something else than plain numbers"),
    "array": (array(b"K\x01\x85", content=EMPTY), "something else than plain numbers"),
    "letters": (array(b"K\x01\x85", content=b"V\\u0394\n"), "as NumPy never does"),
    "short_state": (EMPTY + b"K\x01\x85b.", "as NumPy never does"),
    "no_state": (EMPTY + b".", "an array without content"),
    "dict_state": (EMPTY + b"}b.", "as NumPy never does"),
    "long_state": (EMPTY + b"(" + b"N" * 10 + b"tb.", "as NumPy never does"),
    "dtype_state": (
        b"cnumpy\ndtype\nVf8\n\x85R(K\x03V<\nNVx\nNK\x00K\x00K\x00tb.",
        "plain numbers",
    ),
    "dtype_order": (b"cnumpy\ndtype\nVf8\n\x85R(K\x03VX\nNNNK\x00K\x00K\x00tb.", "plain numbers"),
    "buffer_order": (from_buffer(EIGHT, F8, b"K\x01\x85", b"VX\n"), "as NumPy never does"),
    "buffer_short": (from_buffer(EIGHT, F8), "as NumPy never does"),
    "buffer_axes": (from_buffer(EIGHT, F8, b"K\x01\x85", b"VK\n", b"K\x05\x85"), "never does"),
    "buffer_twice": (from_buffer(EIGHT, F8, b"K\x01\x85", b"VK\n", b"K\x00K\x00\x86"), "never"),
    "buffer_words": (from_buffer(EIGHT, F8, b"K\x01\x85", b"VK\n", b"Vab\n\x85"), "never does"),
    "scalar": (
        b"cnumpy.core.multiarray\nscalar\n" + F8 + b"C\x02ab\x86R.",
        "in 2 bytes, expected 8",
    ),
    "scalar_alone": (b"cnumpy.core.multiarray\nscalar\n" + F8 + b"\x85R.", "as NumPy never does"),
}


def test_the_parts_of_those_arrays_are_right() -> None:
    assert unpickled(array(b"K\x01\x85")).tolist() == [0.0]
    made = from_buffer(EIGHT, F8, b"K\x01K\x01\x86", b"VK\n", b"K\x01K\x00\x86")
    assert unpickled(made).tolist() == [[0.0]]


def test_the_traps_work() -> None:
    pickle.loads(pickle.dumps(Trap(os.mkdir, SPRUNG)))
    assert is_sprung()
    os.rmdir(SPRUNG)
    pickle.loads(pickle.dumps(Trap(eval, SET)))
    assert is_sprung()
    del os.environ[SPRUNG]


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


@pytest.mark.parametrize(
    ("content", "message"),
    [
        pytest.param(*given, id=f"{kind}-{case}")
        for kind, cases in {
            **{"what no array needs": CALLS, "an array that cannot be": STATES},
            **{"small and large": BOMBS, "no pickle": DAMAGED},
        }.items()
        for case, given in cases.items()
    ],
)
def test_what_is_not_plain_data_is_refused(content: bytes, message: str) -> None:
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
