# SPDX-License-Identifier: Apache-2.0
"""Set the workspace up from nothing; the Makefile calls `python3 tools/setup_env.py build|test|bench|docs|lint|check`.

Standard library only. This file must also run under a Python that is too old or too new for the workspace: it
only finds a suitable interpreter and calls the package `envsetup`.
"""

import os
import subprocess
import sys

OLDEST, NEWEST = (3, 10), (3, 13)
VERSION_QUERY = "import sys; print('%d.%d' % sys.version_info[:2])"


def find_other_python() -> "str | None":
    """Return the name of the newest supported python3.X on PATH that starts, or None."""
    for minor in range(NEWEST[1], OLDEST[1] - 1, -1):
        name = "python3.%d" % minor  # noqa: UP031 (readable by any Python 3)
        try:
            seen = subprocess.check_output([name, "-c", VERSION_QUERY], stderr=subprocess.DEVNULL)
        except (OSError, subprocess.CalledProcessError):
            continue
        if seen.decode().strip() == name[len("python") :]:
            return name
    return None


def main() -> int:
    """Run `envsetup` in this interpreter, or in another one if this one is unsupported."""
    if OLDEST <= tuple(sys.version_info[:2]) <= NEWEST:
        from envsetup.cli import main as run

        return run(sys.argv[1:])
    other = find_other_python()
    if other is None:
        message = "[setup] Python 3.10 to 3.13 is needed, but this is Python %d.%d and PATH holds no other: "
        hint = "install one of them, or name one: make PYTHON=/path/to/python3.12"
        sys.stderr.write(message % (sys.version_info[0], sys.version_info[1]) + hint + "\n")
        return 1
    sys.stdout.flush()
    return os.execvp(other, [other, os.path.abspath(__file__), *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
