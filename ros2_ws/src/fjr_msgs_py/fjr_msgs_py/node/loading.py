# SPDX-License-Identifier: Apache-2.0
"""Set up a process before it loads ROS 2, NumPy and CasADi; this module imports none of them."""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

OPEN_FILES, ADDRESS_SPACE = 64, 1_200_000_000
"""What a program with a ROS 2 node needs at least: descriptors, and bytes of address space, of which few are used."""


def require_resources(program: str) -> None:
    """End the program with exit code 1 and one sentence if the limits of its process are too low to load ROS 2.

    The number of open files is raised first, as far as the hard limit allows.
    """
    import resource

    files, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= files < OPEN_FILES:  # -1: no limit
        files = OPEN_FILES if most < 0 else min(OPEN_FILES, most)
        resource.setrlimit(resource.RLIMIT_NOFILE, (files, most))
    space, _ = resource.getrlimit(resource.RLIMIT_AS)
    for seen, least, sentence in (
        (files, OPEN_FILES, "the limit of open files is {}; expected at least {} (ulimit -n)"),
        (space, ADDRESS_SPACE, "the limit of address space is {} bytes; expected at least {} (ulimit -v, in kB)"),
    ):
        if 0 <= seen < least:
            print(f"{program}: {sentence.format(seen, least)}", file=sys.stderr)
            sys.exit(1)


def resume_garbage_collection() -> None:
    """Exempt what is loaded from garbage collection, also when the process ends, and collect from now on."""
    gc.freeze()
    gc.enable()


def index_modules() -> None:
    """Tell `inspect` the files of the loaded modules, which it searches for 50 ms at the first line of a node's log."""
    import inspect

    for name, module in sys.modules.copy().items():
        if file := getattr(module, "__file__", None):
            inspect.modulesbyfile.setdefault(file, name)


def ament_index_of_wheels() -> None:
    """Append this Python environment to AMENT_PREFIX_PATH if it holds these packages as wheels.

    Without it ament finds neither scenarios nor nodes; a sourced workspace stays first.
    """
    marker = os.path.join(sys.prefix, "share", "ament_index", "resource_index", "packages", "fjr_msgs_py")
    known = [path for path in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if path]
    if sys.prefix not in known and os.path.isfile(marker):
        os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join([*known, sys.prefix])


def middleware_of_wheels(program: str) -> None:
    """Take the middleware of ROS 2 from wheels, with a sentence, if RMW_IMPLEMENTATION names one that is not installed.

    rcl would end the process as it is loaded. Elsewhere, as beside a sourced ROS 2, the variable is left as it is.
    """
    wanted, own = os.environ.get("RMW_IMPLEMENTATION", ""), "rmw_fastrtps_cpp"
    packages = os.path.join(sys.prefix, "share", "ament_index", "resource_index", "packages")
    if wanted and os.path.isfile(os.path.join(packages, own)) and not os.path.isfile(os.path.join(packages, wanted)):
        os.environ["RMW_IMPLEMENTATION"] = own
        print(f"{program}: RMW_IMPLEMENTATION is {wanted}, which is not installed; {own} is used", file=sys.stderr)


_HANGUP = () if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN else (signal.SIGHUP,)
SIGNALS = (signal.SIGINT, signal.SIGTERM, *_HANGUP)
"""What ends a process in order: also the terminal that closes, as at the end of an ssh session, unless under nohup."""


def on_signals(handler: Any) -> None:
    """Handle SIGNALS by a function or signal.SIG_IGN from now on."""
    for number in SIGNALS:
        signal.signal(number, handler)


def prepare(program: str, interrupted: int = 0) -> None:
    """Set up the process of an executable: signals, limits, name, garbage, threads, packages, middleware.

    interrupted: exit code on SIGNALS, at once, until process.run() replaces the handlers; the installed
    executables block both while Python starts (scripts/ in each package). Garbage is not collected until
    `resume_garbage_collection`: modules are no garbage, and looking for it takes a quarter of the start.
    """
    on_signals(lambda *_: os._exit(interrupted))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    require_resources(program)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a locale may lack the dash of a table
    with suppress(OSError), open("/proc/self/comm", "w", encoding="ascii") as comm:
        comm.write(program)  # which ps, top and killall show in place of the interpreter (Linux)
    gc.disable()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # more threads of NumPy's linear algebra only add delay
    ament_index_of_wheels()
    middleware_of_wheels(program)


@contextmanager
def signals_blocked() -> Iterator[None]:
    """Block SIGINT and SIGTERM in this thread; child processes started meanwhile inherit the blocked signals."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


LARGEST_DOMAIN = 232  # beyond it DDS has no ports


def domain() -> str:
    """Return the ROS domain of this process, as the environment has it."""
    return os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"


def environment_fault() -> str:
    """Return what is wrong with ROS_DOMAIN_ID or the security of ROS 2, which end the process; "" if nothing is."""
    secured = [os.environ.get(f"ROS_SECURITY_{name}", "") for name in ("ENABLE", "STRATEGY", "KEYSTORE")]
    if secured == ["true", "Enforce", ""]:
        return "ROS_SECURITY_KEYSTORE is not set; expected the folder of the keys that ROS_SECURITY_STRATEGY demands"
    given = domain()
    if given.isascii() and given.isdigit() and int(given) <= LARGEST_DOMAIN:
        return ""
    return f"ROS_DOMAIN_ID is '{given}'; expected a whole number from 0 to {LARGEST_DOMAIN}"


def ensure_log_folder() -> None:
    """Set ROS_LOG_DIR to a new temporary folder if the usual one is not writable, and report it on standard error.

    The usual folder is $ROS_LOG_DIR, $ROS_HOME/log or ~/.ros/log. Child processes share the new folder.
    """
    try:
        places = (("ROS_LOG_DIR", ""), ("ROS_HOME", "log"), ("HOME", ".ros/log"))
        found = [Path(os.environ[name], below) for name, below in places if os.environ.get(name)]
        if not found:
            raise OSError("HOME is not set")
        folder = found[0]
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return
        reason = f"{folder} cannot be written"
    except OSError as error:
        reason = f"{error.filename} cannot be made ({error.strerror})" if error.filename else str(error)
    import tempfile  # loaded on use: a node starts sooner

    os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="fjr-ros-log-")
    print(f"{reason}; the log files of ROS 2 are in {os.environ['ROS_LOG_DIR']}", file=sys.stderr, flush=True)
