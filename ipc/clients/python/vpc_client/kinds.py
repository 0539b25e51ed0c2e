"""What the messages, codes and services in messages.py are kinds of."""

import ctypes
import enum
from typing import NamedTuple


class Code(enum.IntEnum):
    """A number with a name for people."""

    words: str

    def __new__(cls, number: int, words: str = "") -> "Code":
        code = int.__new__(cls, number)
        code._value_, code.words = number, words
        return code

    @classmethod
    def knows(cls, number: int) -> bool:
        """Whether a code has this number; numbers that are not used any more are gaps."""
        return number in cls._value2member_map_


class Message(ctypes.Structure):
    """A structure of the contract."""

    @staticmethod
    def type_name() -> str:
        """The name by which shared memory knows it."""
        raise NotImplementedError

    def __repr__(self) -> str:
        values = ((field[0], getattr(self, field[0])) for field in self._fields_)
        shown = (f"{name}={list(x) if isinstance(x, ctypes.Array) else x!r}" for name, x in values)
        return f"{type(self).__name__}({', '.join(shown)})"


class Service(NamedTuple):
    """A service and its queues; the same for everybody who opens it. Where `alignment` is given, it carries slices of
    bytes that are aligned so, and `message` is their user header."""

    message: type[Message]
    history: int
    buffer: int
    subscribers: int
    publishers: int
    borrowed: int = 1
    alignment: int | None = None
