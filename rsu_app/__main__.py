"""roadgrip-rsu, from the outside: starts the unit or a command of `rsu_app.cli.main`, or says what is not installed."""

from __future__ import annotations

import os
import sys

USAGE_ERROR = 2
OURS = ("roadgrip", "rsu_app")


def main() -> None:
    """Run the command line; without its libraries that is one clear line and exit code 2."""
    try:
        from rsu_app.cli.serving import config_of_plain_serve, serve_plainly

        config_files = config_of_plain_serve(sys.argv[1:], os.environ)
        if config_files is not None:
            serve_plainly(config_files)
            return
        from rsu_app.cli.main import run
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".", 1)[0] in OURS:
            raise
        print(f"roadgrip-rsu: the road side unit needs: pip install 'roadgrip[rsu]' ({error})", file=sys.stderr)
        sys.exit(USAGE_ERROR)
    run()


if __name__ == "__main__":
    main()
