"""What can go wrong; every message names the thing, what was found and what is allowed."""


class VpcError(Exception):
    """Any of these."""


class Taken(VpcError):
    """The place is taken: a service has all the publishers or subscribers that it takes."""


class OtherContract(VpcError):
    """The domain is in use with another version of the contract."""


class BadMessage(VpcError, ValueError):
    """A message breaks the contract: one that came, or one that was to be sent."""


class NoAnswer(VpcError, TimeoutError):
    """No answer came in time."""


class Refused(VpcError):
    """The controller refused a request; `reply` is its answer."""

    def __init__(self, reply, words):
        super().__init__(words)
        self.reply = reply
