"""Exit status 0 where requirements.lock is for this system: Linux with glibc 2.35, x86-64, Python 3.11."""

import platform
import sys

PYTHON, GLIBC = (3, 11), (2, 35)


def main() -> int:
    """0 where the locked files can be installed, 1 elsewhere, with a sentence."""
    library, version = platform.libc_ver()
    glibc = tuple(int(part) for part in version.split(".")[:2]) if library == "glibc" else (0,)
    if sys.version_info[:2] == PYTHON and platform.machine() == "x86_64" and glibc >= GLIBC:
        return 0
    print(
        "requirements.lock is for Linux x86-64 with glibc 2.35 and Python 3.11; this system gets the newest versions "
        "that pyproject.toml allows"
    )
    return 1


if __name__ == "__main__":
    sys.exit(main())
