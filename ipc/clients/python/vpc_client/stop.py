"""The stop file: it needs no lock, no place and no queue."""

from __future__ import annotations

import os
import time
from pathlib import Path

from .domain import default_directory
from .errors import BadDomain, NoAnswer, VpcError

HALF = 32
POLL_S = 0.002


def stop(directory: str | os.PathLike[str] | None = None, patience_s: float = 1.0) -> float:
    """Zero at once, without braking, until the next `arm`. Returns after how many seconds the controller had sent the zero
    twist. The domain in `directory` need not be joined. A file that cannot be written, as on a full disk, is emptied or
    removed: both are stops. Raises NoAnswer if no controller obeys in time: the next one of this domain then begins
    disarmed; BadDomain if the file cannot be used."""
    path = Path(directory or default_directory()) / "stop"
    try:
        return _stop(path, patience_s)
    except VpcError:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadDomain(f"{path}: cannot stop by it: {reason}") from error


def _stop(path: Path, patience_s: float) -> float:
    begin = time.monotonic()
    file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    try:
        _ask(file, path)
        while not _is_obeyed(file):
            if time.monotonic() - begin >= patience_s:
                raise NoAnswer(
                    f"{path}: asked for a stop, which no vpcd obeyed within {patience_s} s; it stays asked for, and the next"
                    " vpcd of this domain begins disarmed"
                )
            time.sleep(POLL_S)
        return time.monotonic() - begin
    finally:
        os.close(file)


def _ask(file: int, path: Path) -> None:
    words = f"{os.getpid()} {time.monotonic_ns()}".encode().ljust(HALF, b"\0")
    try:
        os.pwrite(file, words, 0)
    except OSError:
        try:
            os.ftruncate(file, 0)
        except OSError:
            path.unlink()


def _is_obeyed(file: int) -> bool:
    content = os.pread(file, 2 * HALF, 0)
    return len(content) == 2 * HALF and content[:HALF] == content[HALF:]
