"""Run the command line with `python -m usdface`."""

from usdface.cli import main

if __name__ == "__main__":
    main()
