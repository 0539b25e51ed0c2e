"""A domain: the guard of CONTRACT.md, the services, and the ports that open in it."""

from __future__ import annotations

import ctypes
import fcntl
import os
import re
import shutil
import time
import weakref
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, TypeVar

import iceoryx2 as iox2

from .errors import BadArgument, BadDomain, NoAnswer, OtherContract, Taken
from .images import MOST_BYTES, ImagePublisher, ImageSubscriber
from .messages import SERVICES
from .opening import Opening
from .ports import CameraPorts, OperatorPorts, Port, Publisher, Subscriber, free

# Publishers that iceoryx2 allows beyond those of the contract: places that kills may leave taken.
SPARE = 16

# Least room in shared memory with which a process joins or opens a port, bytes.
ROOM = 1 << 20

# How long joining waits for others that join or leave, and how long to wait for a controller.
PATIENCE_S = 10.0

T = TypeVar("T")
P = TypeVar("P", bound=Port)


def default_directory() -> str:
    """The domain where none is named, /tmp/vpc-UID."""
    return f"/tmp/vpc-{os.geteuid()}"


class Domain(Opening):
    """Membership of a domain. Keep it for as long as its ports are in use.

    Leave it with `close` or at the end of a `with`; its ports are closed with it. A domain belongs to the thread that made
    it: a second thread joins for itself."""

    def __init__(self, directory: str | os.PathLike[str] | None = None) -> None:
        self._startup: int | None = None
        self._prefix: str | None = None
        self.directory = self._claim(default_directory() if directory is None else directory)
        os.makedirs(os.path.join(self.directory, "publishers"), mode=0o700, exist_ok=True)
        self._startup = self._open("startup")
        self._member = self._open("lock")
        self._inode = _inode(self.directory)
        # Weakly: ports keep their domain.
        self._ports: weakref.WeakSet[Port] = weakref.WeakSet()
        self._node: Any = None
        self._services: dict[str, Any] = {}
        self._exclusively(self._join)

    def __enter__(self) -> Domain:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Domain({self.directory!r}{', closed' if self._startup is None else ''})"

    def close(self) -> None:
        """Closes the ports and leaves. The second time it does nothing."""
        if self._startup is None:
            return
        for port in list(self._ports):
            port.close()
        try:
            self._exclusively(self._leave)
        except NoAnswer:
            # Another process was stopped while it joined: leave all the same.
            self._services, self._node = {}, None
        os.close(self._member)
        os.close(self._startup)
        self._startup = None

    def _publisher(self, service: str) -> Publisher[Any]:
        return self._port(service, lambda: Publisher(service, *self._publishing(service)))

    def _subscriber(self, service: str, buffer: int | None) -> Subscriber[Any]:
        return self._port(service, lambda: Subscriber(service, self._subscribing(service, buffer)))

    def image_publisher(self, most: int) -> ImagePublisher:
        """Opens the publisher of images of at most `most` bytes; raises Taken while another camera sends images."""
        if not 1 <= most <= MOST_BYTES:
            raise BadArgument(f"vpc/image: images of {most} bytes; allowed: 1 to {MOST_BYTES}")
        return self._port("vpc/image", lambda: ImagePublisher(*self._publishing("vpc/image", most), most), True)

    def image_subscriber(self) -> ImageSubscriber:
        """Opens a subscriber of images."""
        return self._port("vpc/image", lambda: ImageSubscriber("vpc/image", self._subscribing("vpc/image")), True)

    def camera(self) -> CameraPorts:
        """Opens the ports of a camera; raises Taken while another camera is at work."""
        twist = self.subscribe("vpc/twist", 4)
        # The subscriber first: no answer may be missed.
        return CameraPorts(twist, self._or_close("vpc/features", twist))

    def operator(self) -> OperatorPorts:
        """Opens the ports of an operator. Close them soon: there are few slots."""
        replies = self.subscribe("vpc/replies")
        return OperatorPorts(replies, self._or_close("vpc/requests", replies), self)

    def has_controller(self) -> bool:
        """Whether a controller is in the domain: the one publisher of replies."""

        def probe() -> bool:
            place = self._place("vpc/replies")
            if place is not None:
                free(place, os.getpid())
            return place is None

        return self._exclusively(probe)

    def wait_for_controller(self, patience_s: float = PATIENCE_S) -> None:
        """Waits until a controller is in the domain; raises NoAnswer where none comes in time."""
        end = time.monotonic() + patience_s
        while not self.has_controller():
            if time.monotonic() >= end:
                raise NoAnswer(f"domain {self.directory}: no controller within {patience_s} s; start vpcd in this domain")
            time.sleep(0.05)

    @staticmethod
    def _claim(directory: str | os.PathLike[str]) -> str:
        """The real path of a directory of our own that nobody else can write to; makes it where it is missing."""
        try:
            path = os.fspath(directory)
            os.makedirs(path, mode=0o700, exist_ok=True)
            status = os.lstat(path)
        except (OSError, TypeError, ValueError) as error:
            raise BadDomain(f"domain {directory!r}: {error}; allowed: a directory") from error
        if os.path.islink(path) or status.st_uid != os.geteuid():
            raise BadDomain(f"domain {path}: allowed: a directory (no link) of our own")
        mode = status.st_mode & 0o777
        if mode & 0o022:
            raise BadDomain(f"domain {path}: mode {mode:03o} lets other users put files into it; allowed: mode 700")
        return os.path.realpath(path)

    def _open(self, name: str) -> int:
        path = os.path.join(self.directory, name)
        try:
            return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise BadDomain(f"domain {self.directory}: {error}; allowed: a directory that we can write to") from error

    def _exclusively(self, action: Callable[[], T]) -> T:
        """Runs `action` while nobody else joins, leaves or opens a port."""
        if self._startup is None:
            raise BadArgument(f"domain {self.directory}: left already; allowed: ports of a domain that was not closed")
        end = time.monotonic() + PATIENCE_S
        while True:
            try:
                fcntl.flock(self._startup, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > end:
                    raise NoAnswer(f"domain {self.directory}: another process is joining or leaving") from None
                time.sleep(0.001)
        try:
            return action()
        finally:
            fcntl.flock(self._startup, fcntl.LOCK_UN)

    def _check_room(self) -> None:
        """Where shared memory is full, SIGBUS ends whoever writes to it."""
        found = os.statvfs("/dev/shm")
        free = found.f_bavail * found.f_frsize
        if found.f_blocks > 0 and free < ROOM:
            raise BadDomain(
                f"domain {self.directory}: /dev/shm has {free} bytes free; needed: {ROOM}; remove what fills it (du -a /dev/shm"
                " | sort -n), or make it larger (mount -o remount,size=1G /dev/shm); a stop needs none of it"
            )

    def _place(self, service: str) -> int | None:
        """A place among the publishers of a service, which closing it frees; None while others have them all."""
        for place in range(1, SERVICES[service].publishers + 1):
            file = self._open(os.path.join("publishers", f"{service.replace('/', '-')}-{place}"))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return file
            except BlockingIOError:
                os.close(file)
            except BaseException:
                os.close(file)
                raise
        return None

    def _join(self) -> None:
        if self._is_alone():
            self._wipe()
            self._begin_generation()
        fcntl.flock(self._member, fcntl.LOCK_SH | fcntl.LOCK_NB)
        self._prefix = self._read_prefix()
        if self._prefix is None:
            raise BadDomain(
                f"{self._generation_file()}: damaged; allowed: 16 hexadecimal digits; stop every process of this domain, then"
                " start again"
            )
        self._remove_unborn()
        self._check_room()

        iox2.set_log_level(iox2.LogLevel.Error)
        config = iox2.config.default()
        config.global_cfg.root_path = iox2.Path.new(os.path.join(self.directory, "iox2"))
        config.global_cfg.prefix = iox2.FileName.new(self._prefix)
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        builder = iox2.NodeBuilder.new().config(config)
        self._node = builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled).create(iox2.ServiceType.Ipc)
        self._services = {name: self._service(name) for name in SERVICES}

    def _leave(self) -> None:
        self._services, self._node = {}, None
        # Another directory at this path is others' to clear.
        if self._is_alone() and self._inode == _inode(self.directory):
            self._wipe()

    def _service(self, name: str) -> Any:
        service = SERVICES[name]
        builder = self._node.service_builder(iox2.ServiceName.new(name))
        if service.alignment is None:
            builder = builder.publish_subscribe(service.message)
        else:
            builder = builder.publish_subscribe(iox2.Slice[ctypes.c_uint8]).user_header(service.message)
            builder = builder.payload_alignment(iox2.Alignment.new(service.alignment))
        builder = (
            builder.max_publishers(service.publishers + SPARE)
            .max_subscribers(service.subscribers)
            .max_nodes(32)
            .history_size(service.history)
            .subscriber_max_buffer_size(service.buffer)
            .subscriber_max_borrowed_samples(service.borrowed)
            .enable_safe_overflow(True)
        )
        try:
            return builder.open_or_create()
        except iox2.PublishSubscribeOpenOrCreateError as error:
            raise OtherContract(
                f"domain {self.directory}: {name} cannot be opened ({error}); is a process of another version in it?"
            ) from error

    def _is_alone(self) -> bool:
        """Whether nobody else is in the domain. Ask it only while nobody else can join."""
        try:
            fcntl.flock(self._member, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            return False

    def _wipe(self) -> None:
        """Removes what processes left that were killed. Call it only while no other process is in the domain."""
        shutil.rmtree(os.path.join(self.directory, "iox2"), ignore_errors=True)
        self._prefix = self._read_prefix()
        for path, _ in list(self._segments()):
            os.unlink(path)

    def _generation_file(self) -> str:
        return os.path.join(self.directory, "generation")

    def _begin_generation(self) -> None:
        """Draws the number that names the domain's shared memory. Call it only while no other process is in the domain."""
        file = os.open(self._generation_file(), os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
        try:
            os.write(file, (os.urandom(8).hex() + "\n").encode())
        finally:
            os.close(file)

    def _read_prefix(self) -> str | None:
        """Begin of the names of the domain's shared memory; None without a generation."""
        try:
            with open(self._generation_file(), encoding="ascii") as file:
                digits = file.read(32).strip()
        except (OSError, UnicodeDecodeError):
            return None
        return f"vpc_{digits}_" if re.fullmatch("[0-9a-f]{16}", digits) else None

    def _segments(self) -> Iterator[tuple[str, os.stat_result]]:
        """The domain's shared memory: paths and what the system says of them. Other users' files are not ours."""
        if self._prefix is None:
            return
        for entry in os.scandir("/dev/shm"):
            try:
                if entry.name.startswith(self._prefix) and entry.stat().st_uid == os.geteuid():
                    yield entry.path, entry.stat()
            except FileNotFoundError:
                pass

    def _empty_segments(self) -> Iterator[tuple[str, float]]:
        """Shared memory without a size: its path and its age in s."""
        for path, found in self._segments():
            if found.st_size == 0:
                yield path, time.time() - found.st_mtime

    def _remove_unborn(self) -> None:
        """Removes shared memory that a killed process created and never gave a size: iceoryx2 would wait for it."""
        for _ in range(120):
            is_young = False
            for path, age_s in list(self._empty_segments()):
                if age_s >= 0.3:
                    os.unlink(path)
                else:
                    is_young = True
            if not is_young:
                return
            time.sleep(0.005)

    def _port(self, service: str, create: Callable[[], P], slices: bool = False) -> P:
        """Opens a port that keeps its domain; of a service that carries `slices`, or messages."""
        allowed = [name for name, known in SERVICES.items() if slices or known.alignment is None]
        if service not in allowed:
            raise BadArgument(f"service {service}; allowed: {', '.join(allowed)}; image_publisher and image_subscriber")

        def checked() -> P:
            self._check_room()
            return create()

        port = self._exclusively(checked)
        port.domain = self
        self._ports.add(port)
        return port

    def _publishing(self, service: str, slice_len: int | None = None) -> tuple[Any, int]:
        """A publisher of iceoryx2, and its place."""
        place = self._place(service)
        if place is None:
            most = SERVICES[service].publishers
            raise Taken(
                f"{service}: another publisher is at work in domain {self.directory}; allowed: {most} (stop the other, or"
                " use another domain)"
            )

        def create() -> Any:
            builder = self._services[service].publisher_builder().max_loaned_samples(1)
            return (builder if slice_len is None else builder.initial_max_slice_len(slice_len)).create()

        try:
            return self._create(create), place
        except BaseException as error:
            free(place, os.getpid())
            if isinstance(error, iox2.PublisherCreateError):
                raise Taken(f"{service}: iceoryx2 refused the publisher: {error}") from error
            raise

    def _subscribing(self, service: str, buffer: int | None = None) -> Any:
        """A subscriber of iceoryx2."""
        most = SERVICES[service].buffer
        size = most if buffer is None else buffer
        if not 1 <= size <= most:
            raise BadArgument(f"{service}: buffer = {size}; allowed: 1 to {most}")
        try:
            return self._create(lambda: self._services[service].subscriber_builder().buffer_size(size).create())
        except iox2.SubscriberCreateError as error:
            most = SERVICES[service].subscribers
            raise Taken(f"{service}: no subscriber ({error}); allowed: {most}") from error

    def _or_close(self, service: str, other: Port) -> Publisher[Any]:
        """A publisher; where there is none, `other` is closed as well."""
        try:
            return self.publisher(service)
        except BaseException:
            other.close()
            raise

    def _create(self, create: Callable[[], Any]) -> Any:
        """Creates a port; once more without the processes that were killed meanwhile, should they hold its place."""
        try:
            return create()
        except (iox2.PublisherCreateError, iox2.SubscriberCreateError):
            self._remove_unborn()
            iox2.Node.try_cleanup_dead_nodes(iox2.ServiceType.Ipc, self._node.config)
            return create()


def _inode(directory: str) -> tuple[int, int]:
    """Device and inode of a directory; (0, 0) where there is none."""
    try:
        found = os.lstat(directory)
    except OSError:
        return 0, 0
    return found.st_dev, found.st_ino
