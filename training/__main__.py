"""roadgrip-train, from the outside: starts the commands of `training.cli`, or says what is not installed."""

from __future__ import annotations

import os
import sys

USAGE_ERROR = 2
OURS = ("roadgrip", "rsu_app", "vehicle_client", "training")


def main() -> None:
    """Run the command line; without the laboratory's libraries that is one clear line and exit code 2."""
    # Before numpy comes in: filters multiply small matrices, over which several threads only wait for one another.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Imported here for a second reason, too: workers that drive start from this module, and need no command line.
    try:
        from training.cli import run
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".", 1)[0] in OURS:
            raise
        print(f"roadgrip-train: the laboratory needs: pip install 'roadgrip[training]' ({error})", file=sys.stderr)
        sys.exit(USAGE_ERROR)
    run()


if __name__ == "__main__":
    main()
