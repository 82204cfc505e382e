"""The stack machine that a pickle is a program for, in a form that runs nothing of the file's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from phase_ppl.dataset.authors.arrays import STAND_INS, PickledArray, PickledDtype
from phase_ppl.dataset.authors.source import VALUES, Source, integer_line
from phase_ppl.world.errors import InvalidEventError, shown

MAX_OPCODES: Final = 2_000_000
"""Opcodes that are read, which takes a few seconds."""

MAX_CONVERTED: Final = 256 * 2**20
"""Characters that become bytes."""

_MOST_ARGUMENTS: Final = 9
"""Longest tuple that describes an array, or that is the key of a dict."""

_STOP: Final = b"."


class Machine:
    """Interprets the opcodes of protocols 0 to 5."""

    def __init__(self, content: bytes) -> None:
        self.source = Source(content)
        self.stack: list[Any] = []
        self.below: list[list[Any]] = []  # what lies under each open mark
        self.memo: dict[int, Any] = {}
        self.converted = 0

    def run(self) -> Any:
        """Return what the pickle describes, where arrays are a :class:`PickledArray`.

        Raises:
            InvalidEventError: too many opcodes, damaged, or it asks for what is not allowed.
        """
        source = self.source
        for _ in range(MAX_OPCODES):
            opcode = source.take(1)
            if opcode == _STOP:
                break
            value = VALUES.get(opcode)
            if value is not None:
                self.stack.append(value(source))
            else:
                _action(opcode)(self)
        else:
            raise InvalidEventError(f"has more than {MAX_OPCODES} opcodes")
        if not self.source.at_end:
            raise InvalidEventError("goes on after the end of its pickle")
        result = self.pop()
        if self.stack or self.below:
            raise _damaged()
        return result

    def pop(self) -> Any:
        if not self.stack:
            raise _damaged()
        return self.stack.pop()

    def top(self, kind: type) -> Any:
        if not self.stack or type(self.stack[-1]) is not kind:
            raise _damaged()
        return self.stack[-1]

    def pop_to_mark(self) -> list[Any]:
        if not self.below:
            raise _damaged()
        values, self.stack = self.stack, self.below.pop()
        return values

    def call(self) -> None:
        arguments, function = self.pop(), self.pop()
        if not callable(function):
            raise InvalidEventError("calls what is no function")
        self.stack.append(function(self.few(arguments)))

    def set_state(self) -> None:
        state = self.pop()
        if not self.stack or not isinstance(self.stack[-1], (PickledArray, PickledDtype)):
            raise InvalidEventError("sets the state of what is no array")
        self.stack[-1].set_state(self.few(state))

    def few(self, values: object) -> tuple[Any, ...]:
        """Return a tuple that describes an array.

        Texts in it become bytes. They are counted: one that is shared does so again and again.
        """
        if not isinstance(values, tuple) or len(values) > _MOST_ARGUMENTS:
            raise _damaged()
        self.converted += sum(len(value) for value in values if isinstance(value, str))
        if self.converted > MAX_CONVERTED:
            raise InvalidEventError("becomes too large: it shares long texts")
        return values

    def ask_for(self, module: object, name: object) -> None:
        if not (isinstance(module, str) and isinstance(name, str)):
            raise _damaged()
        stand_in = STAND_INS.get((module, name))
        if stand_in is None:
            raise InvalidEventError(
                f"asks for {shown(f'{module[:60]}.{name[:60]}')}, which is refused: only dicts, "
                "lists, tuples, texts, numbers and arrays of numbers are read"
            )
        self.stack.append(stand_in)

    def put(self, place: int) -> None:
        if not self.stack:
            raise _damaged()
        self.memo[place] = self.stack[-1]

    def get(self, place: int) -> None:
        if place not in self.memo:
            raise _damaged()
        self.stack.append(self.memo[place])

    def make_tuple(self, count: int) -> None:
        if len(self.stack) < count:
            raise _damaged()
        self.stack[-count:] = [tuple(self.stack[-count:])]

    def extend_dict(self, target: dict[Any, Any], values: list[Any]) -> None:
        if len(values) % 2:
            raise _damaged()
        for key, value in zip(values[::2], values[1::2], strict=True):
            parts = key if type(key) is tuple and len(key) <= _MOST_ARGUMENTS else (key,)
            if any(type(part) not in (str, int) for part in parts):
                raise InvalidEventError("has a dict whose keys are no texts or whole numbers")
            target[key] = value

    def mark(self) -> None:
        self.below.append(self.stack)
        self.stack = []

    def global_by_name(self) -> None:
        module = self.source.text_line()
        self.ask_for(module, self.source.text_line())

    def global_of_stack(self) -> None:
        name, module = self.pop(), self.pop()
        self.ask_for(module, name)

    def copy_top(self) -> None:
        value = self.pop()
        self.stack += [value, value]

    def append(self) -> None:
        value = self.pop()
        self.top(list).append(value)

    def extend(self) -> None:
        values = self.pop_to_mark()
        self.top(list).extend(values)

    def set_item(self) -> None:
        value, key = self.pop(), self.pop()
        self.extend_dict(self.top(dict), [key, value])

    def set_items(self) -> None:
        values = self.pop_to_mark()
        self.extend_dict(self.top(dict), values)

    def dict_of_marked(self) -> None:
        values = self.pop_to_mark()
        made: dict[Any, Any] = {}
        self.extend_dict(made, values)
        self.stack.append(made)

    def list_of_marked(self) -> None:
        values = self.pop_to_mark()
        self.stack.append(values)

    def tuple_of_marked(self) -> None:
        values = self.pop_to_mark()
        self.stack.append(tuple(values))

    def protocol(self) -> None:
        version = self.source.number("<B")
        if version > 5:
            raise InvalidEventError(f"is a pickle of protocol {version}, expected at most 5")


def _action(opcode: bytes) -> Callable[[Machine], Any]:
    action = _ACTIONS.get(opcode)
    if action is None:
        what = _REFUSED.get(opcode)
        raise InvalidEventError(
            f"is damaged: unknown opcode {opcode!r}" if what is None else f"holds {what}, refused"
        )
    return action


_ACTIONS: Final[Mapping[bytes, Callable[[Machine], Any]]] = {
    b"(": Machine.mark,
    b"0": Machine.pop,
    b"1": Machine.pop_to_mark,
    b"2": Machine.copy_top,
    b"a": Machine.append,
    b"e": Machine.extend,
    b"s": Machine.set_item,
    b"u": Machine.set_items,
    b"d": Machine.dict_of_marked,
    b"l": Machine.list_of_marked,
    b"t": Machine.tuple_of_marked,
    b"\x85": lambda machine: machine.make_tuple(1),
    b"\x86": lambda machine: machine.make_tuple(2),
    b"\x87": lambda machine: machine.make_tuple(3),
    b"p": lambda machine: machine.put(integer_line(machine.source)),
    b"q": lambda machine: machine.put(machine.source.number("<B")),
    b"r": lambda machine: machine.put(machine.source.number("<I")),
    b"\x94": lambda machine: machine.put(len(machine.memo)),
    b"g": lambda machine: machine.get(integer_line(machine.source)),
    b"h": lambda machine: machine.get(machine.source.number("<B")),
    b"j": lambda machine: machine.get(machine.source.number("<I")),
    b"c": Machine.global_by_name,
    b"\x93": Machine.global_of_stack,
    b"R": Machine.call,
    b"b": Machine.set_state,
    b"\x80": Machine.protocol,
    b"\x95": lambda machine: machine.source.number("<Q"),  # a frame: of no meaning here
}
"""Opcode -> what it does; those that put a value onto the stack are in ``VALUES``."""

_REFUSED: Final[Mapping[bytes, str]] = {
    **dict.fromkeys((b"i", b"o", b"\x81", b"\x92"), "an object of a class"),
    **dict.fromkeys((b"P", b"Q"), "a reference to something outside the file"),
    **dict.fromkeys((b"\x82", b"\x83", b"\x84"), "a number that stands for a class"),
    **dict.fromkeys((b"\x8f", b"\x90", b"\x91"), "a set"),
    **dict.fromkeys((b"\x97", b"\x98"), "a buffer outside the file"),
}


def _damaged() -> InvalidEventError:
    return InvalidEventError("is damaged: its pickle makes no sense")
