"""``python -m circlecal``."""

from circlecal.cli import main

if __name__ == "__main__":
    main()
