"""`python -m softplc` is the softplc command."""

from softplc.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
