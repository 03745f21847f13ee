# SPDX-License-Identifier: Apache-2.0
"""Separate a test process from its user and its machine: environment, home, caches, ROS domain, and an end in time."""

from __future__ import annotations

import atexit
import faulthandler
import os
import shutil
import signal
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CACHE = ROOT / "build" / "test-cache"
"""Compiled code, kept between runs of the suite in this checkout."""
PROFILE = ROOT / "ros2_ws" / "src" / "fjr_bringup" / "config" / "fastdds.xml"

LEASE_PORTS = range(47001, 47100)  # one TCP port on 127.0.0.1 per domain id 1..99; the kernel frees it on any death
DDS_PORTS, DDS_PORTS_PER_DOMAIN = 7400, 250
OF_THE_USER = (
    *("ROS_", "RMW_", "RCL_", "RCUTILS_", "FASTRTPS_", "FASTDDS_", "CYCLONEDDS_", "XDG_", "LC_", "LANG", "MPL"),
    *("DISPLAY", "WAYLAND_DISPLAY", "COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "BROWSER", "SOURCE_DATE_EPOCH"),
)
"""Beginnings of the names of variables that no test inherits."""
OF_THE_INSTALLATION = ("ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION")
END_LIMIT = 60.0  # s for the end of a test or of the process, milliseconds on an idle machine


def isolate() -> None:
    """Set environment, umask, ROS domain and SIGHUP of this process and its children."""
    pip = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "pip")
    settings = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config", "pip", "pip.conf")
    for name in list(os.environ):
        if name.startswith(OF_THE_USER) and name not in OF_THE_INSTALLATION:
            del os.environ[name]
    os.environ.setdefault("PIP_CACHE_DIR", str(pip))
    if settings.is_file():
        os.environ.setdefault("PIP_CONFIG_FILE", str(settings))
    home = tempfile.mkdtemp(prefix="fjr-test-home-")
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    os.umask(0o022)
    if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:  # as under nohup; children inherit this, but no handler
        signal.signal(signal.SIGHUP, lambda *_: None)
    local = ",".join(filter(None, (os.environ.get("no_proxy"), "127.0.0.1,localhost")))
    os.environ |= {
        "OPENBLAS_NUM_THREADS": os.environ.get("OPENBLAS_NUM_THREADS", "1"),  # more only delay small matrices
        "HOME": home,
        "XDG_CACHE_HOME": str(CACHE),
        "MPLCONFIGDIR": str(CACHE / "matplotlib"),
        "LC_ALL": "C.UTF-8",
        "TZ": "UTC",
        "no_proxy": local,
        "NO_PROXY": local,
        "ROS_DOMAIN_ID": leased_domain(),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(Path(home, "log")),
        "ROS_PYTHON_CHECK_FIELDS": "1",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILE),
    }
    CACHE.mkdir(parents=True, exist_ok=True)


def leased_domain() -> str:
    """Return a ROS domain id that no other test process and no other program uses, leased until this process ends."""
    taken = _domains_in_use()
    for number, port in enumerate(LEASE_PORTS, 1):
        lease = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            lease.bind(("127.0.0.1", port))
        except OSError:
            lease.close()
            continue
        if number not in taken:
            atexit.register(lease.close)
            return str(number)
        lease.close()
    raise RuntimeError("all ROS domain ids 1..99 are in use by other processes")


def _domains_in_use() -> set[int]:
    """Return the domains of bound UDP ports of DDS, and of shared memory that another user left."""
    ports = []
    with suppress(OSError):
        lines = Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]
        ports += [int(line.split()[1].rpartition(":")[2], 16) for line in lines]
    for path in Path("/dev/shm").glob("fastrtps_port*"):
        with suppress(OSError, ValueError):
            if path.stat().st_uid != os.getuid():
                ports.append(int(path.name.removeprefix("fastrtps_port").partition("_")[0]))
    return {(port - DDS_PORTS) // DDS_PORTS_PER_DOMAIN for port in ports}


@contextmanager
def without_proofs(folder: Path) -> Iterator[str]:
    """Yield a cache that shares the compiled code, but not the kept proofs, which change what `fjr check` prints."""
    shared, own = CACHE / "fjr", folder / "fjr"
    for path in (shared, own):
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    _link_code(shared, own)
    yield str(folder)
    _link_code(own, shared)


def _link_code(source: Path, target: Path) -> None:
    for path in source.iterdir():
        if path.is_file() and not path.name.startswith((".", "rate-")):
            with suppress(OSError):  # it is there already
                os.link(path, target / path.name)


@contextmanager
def ends_in_time(errors: int) -> Iterator[None]:
    """End the process with the stacks of its threads if the block hangs, even in native code; errors: descriptor."""
    faulthandler.dump_traceback_later(END_LIMIT, exit=True, file=errors)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def end_soon(errors: int) -> None:
    """Let the process end within the limit, if need be by the alarm of the kernel once Python has gone."""
    faulthandler.dump_traceback_later(END_LIMIT, exit=True, file=os.dup(errors))  # pytest closes its own
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(round(END_LIMIT) + 10)
