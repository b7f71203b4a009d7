"""roadgrip-vehicle, from the outside: starts the commands of `vehicle_client.cli`, or says what is not installed."""

from __future__ import annotations

import os
import sys

USAGE_ERROR = 2
OURS = ("roadgrip", "vehicle_client")
EXTRA_OF = {
    "numba": "sim",
    "scipy": "sim",
    "matplotlib": "demo",
    "asammdf": "vehicle-files",
    "pyarrow": "vehicle-files",
}
"""Which extra brings a library, where it is not `vehicle`."""


def main() -> None:
    """Run the command line; without its libraries that is one clear line and exit code 2."""
    # Before numpy comes in: small matrices in several threads cost a busy computer nine times the work.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from vehicle_client.cli import run

        run()
    except ModuleNotFoundError as error:
        library = (error.name or "").split(".", 1)[0]
        if library in {"", *OURS}:
            raise
        extra = EXTRA_OF.get(library, "vehicle")
        print(f"roadgrip-vehicle: this needs: pip install 'roadgrip[{extra}]' ({error})", file=sys.stderr)
        sys.exit(USAGE_ERROR)


if __name__ == "__main__":
    main()
