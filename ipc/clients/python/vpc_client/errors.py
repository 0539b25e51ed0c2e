"""What can go wrong. Every message names the thing, what was found, and what is allowed."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .messages import Reply


class VpcError(Exception):
    """Base class of all errors of this package."""


class BadArgument(VpcError, ValueError):
    """An argument is out of its range, or a domain or port was closed before."""


class BadDomain(VpcError, OSError):
    """A directory cannot serve as a domain."""


class Taken(VpcError):
    """A service has all the publishers or subscribers that it takes."""


class OtherContract(VpcError):
    """The domain is in use with another version of the contract."""


class BadMessage(VpcError, ValueError):
    """A message breaks the contract: one that came, or one that was to be sent."""


class NoAnswer(VpcError, TimeoutError):
    """No answer came in time, or nobody is there to give one."""


class Refused(VpcError):
    """The controller refused a request; `reply` is its answer."""

    def __init__(self, reply: Reply, words: str) -> None:
        super().__init__(words)
        self.reply = reply
