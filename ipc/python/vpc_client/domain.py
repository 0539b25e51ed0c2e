"""A domain: the guard of CONTRACT.md, the services, and the ports that open in it."""

import fcntl
import os
import shutil
import time
import weakref

import iceoryx2 as iox2

from .errors import OtherContract, Taken
from .messages import SERVICES
from .ports import CameraPorts, OperatorPorts, Publisher, Subscriber

# How long joining waits for others that join or leave.
PATIENCE_S = 10.0


def default_directory():
    return f"/tmp/vpc-{os.geteuid()}"


class Domain:
    """Membership of a domain, with the guard of CONTRACT.md; keep it for as long as its ports are in use.

    Leave it with `close` or at the end of a `with`; its ports are closed with it. It stays in its thread: a second
    thread joins for itself."""

    def __init__(self, directory=None):
        directory = default_directory() if directory is None else os.fspath(directory)
        os.makedirs(directory, mode=0o700, exist_ok=True)
        if os.path.islink(directory) or os.stat(directory).st_uid != os.geteuid():
            raise PermissionError(f"domain {directory}: allowed: a directory (no link) of our own")
        mode = os.stat(directory).st_mode & 0o777
        if mode & 0o022:
            raise PermissionError(
                f"domain {directory}: mode {mode:03o} lets other users put files into it; allowed: mode 700"
            )
        self.directory = os.path.realpath(directory)
        self._startup = self._open("startup")
        self._member = self._open("lock")
        # Weakly: ports keep their domain.
        self._ports = weakref.WeakSet()
        self.node = None
        self.start_up(self._join)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """Closes the ports and leaves. The second time it does nothing."""
        if self._startup is None:
            return
        for port in list(self._ports):
            port.close()
        try:
            self.start_up(self._leave)
        except TimeoutError:
            # Somebody who joins was stopped: leave all the same.
            self.services, self.node = {}, None
        os.close(self._member)
        os.close(self._startup)
        self._startup = None

    def _leave(self):
        self.services = {}
        self.node = None
        if self._alone():
            self._wipe()

    def _alone(self):
        """Whether nobody else is in the domain; only to be asked within start_up."""
        try:
            fcntl.flock(self._member, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            return False

    def _wipe(self):
        """Removes what the dead left; only for who is alone."""
        shutil.rmtree(os.path.join(self.directory, "iox2"), ignore_errors=True)
        prefix = self._prefix()
        for name in os.listdir("/dev/shm"):
            if name.startswith(prefix):
                os.unlink(os.path.join("/dev/shm", name))

    def _open(self, name):
        return os.open(os.path.join(self.directory, name), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)

    def start_up(self, action):
        """Runs `action` while nobody else joins, leaves or opens a port."""
        end = time.monotonic() + PATIENCE_S
        while True:
            try:
                fcntl.flock(self._startup, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > end:
                    raise TimeoutError(f"domain {self.directory}: another process is joining or leaving") from None
                time.sleep(0.001)
        try:
            return action()
        finally:
            fcntl.flock(self._startup, fcntl.LOCK_UN)

    def _join(self):
        prefix = self._prefix()
        if self._alone():
            self._wipe()
        fcntl.flock(self._member, fcntl.LOCK_SH | fcntl.LOCK_NB)
        self._remove_unborn(prefix)

        iox2.set_log_level(iox2.LogLevel.Error)
        config = iox2.config.default()
        config.global_cfg.root_path = iox2.Path.new(os.path.join(self.directory, "iox2"))
        config.global_cfg.prefix = iox2.FileName.new(prefix)
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        self.node = (
            iox2.NodeBuilder.new()
            .config(config)
            .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            .create(iox2.ServiceType.Ipc)
        )
        self.services = {name: self._service(name, *service) for name, service in SERVICES.items()}

    def _service(self, name, message, history, buffer, subscribers, publishers):
        builder = (
            self.node.service_builder(iox2.ServiceName.new(name))
            .publish_subscribe(message)
            .max_publishers(publishers)
            .max_subscribers(subscribers)
            .max_nodes(32)
            .history_size(history)
            .subscriber_max_buffer_size(buffer)
            .subscriber_max_borrowed_samples(1)
            .enable_safe_overflow(True)
        )
        try:
            return builder.open_or_create()
        except iox2.PublishSubscribeOpenOrCreateError as error:
            raise OtherContract(
                f"domain {self.directory}: {name} cannot be opened ({error}); is a process of another version in it?"
            ) from error

    @staticmethod
    def _remove_unborn(prefix):
        """Removes shared memory that a killed process created and never gave a size: iceoryx2 would wait for it."""

        def empty():
            for entry in os.scandir("/dev/shm"):
                try:
                    if entry.name.startswith(prefix) and entry.stat().st_size == 0:
                        yield entry
                except FileNotFoundError:
                    pass

        for _ in range(120):
            young = False
            for entry in list(empty()):
                if time.time() - entry.stat().st_mtime >= 0.3:
                    os.unlink(entry.path)
                else:
                    young = True
            if not young:
                return
            time.sleep(0.005)

    def _prefix(self):
        value = 0xCBF29CE484222325
        for byte in os.fsencode(self.directory):
            value = ((value ^ byte) * 0x100000001B3) % 2**64
        return f"vpc_{value:016x}_"

    def publisher(self, name):
        """The publisher of the service `name`; see Publisher."""

        def create():
            try:
                port = self._alive(lambda: self.services[name].publisher_builder().max_loaned_samples(1).create())
            except iox2.PublisherCreateError as error:
                most = SERVICES[name].publishers
                raise Taken(
                    f"{name}: no publisher in domain {self.directory} ({error}); allowed: {most} (stop the other, or use"
                    " another domain)"
                ) from error
            return self._keep(Publisher(name, port))

        return self._port(name, create)

    def subscriber(self, name, buffer=None):
        """A subscriber that keeps the newest `buffer` messages [as many as the service allows]; see Subscriber."""

        def create():
            most = SERVICES[name].buffer
            size = most if buffer is None else max(1, min(buffer, most))
            try:
                port = self._alive(lambda: self.services[name].subscriber_builder().buffer_size(size).create())
            except iox2.SubscriberCreateError as error:
                raise Taken(f"{name}: no subscriber ({error}); allowed: {SERVICES[name].subscribers}") from error
            return self._keep(Subscriber(name, port))

        return self._port(name, create)

    # What watches says so.
    subscribe = subscriber

    def camera(self):
        """The camera's ports; Taken while another camera is at work."""
        return CameraPorts(self)

    def operator(self):
        """An operator's ports; stay no longer than needed, there are few places."""
        return OperatorPorts(self)

    def _port(self, name, create):
        if name not in SERVICES:
            raise ValueError(f"service {name}; allowed: {', '.join(SERVICES)}")
        if self._startup is None:
            raise ValueError(f"domain {self.directory}: left already; allowed: ports of a domain that was not closed")
        return self.start_up(create)

    def _alive(self, create):
        """Creates a port; once more without those who were killed since we joined, should they hold its place."""
        try:
            return create()
        except (iox2.PublisherCreateError, iox2.SubscriberCreateError):
            self._remove_unborn(self._prefix())
            iox2.Node.try_cleanup_dead_nodes(iox2.ServiceType.Ipc, self.node.config)
            return create()

    def _keep(self, port):
        port.domain = self
        self._ports.add(port)
        return port
