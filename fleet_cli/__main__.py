"""``python -m fleet_cli`` is ``fleet``."""

from fleet_cli.main import main

if __name__ == "__main__":
    main()
