"""roadgrip-authority, from the outside."""

from __future__ import annotations

from training.authority.cli import run

__all__ = ["main"]

main = run

if __name__ == "__main__":
    main()
