"""``python -m fleet_bus.schemas``: write the schema files anew."""

from pathlib import Path

from fleet_bus.schemas import generate, shipped

if __name__ == "__main__":
    folder = Path(__file__).parent
    files = generate()
    for name in shipped().keys() - files.keys():
        (folder / name).unlink()
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    print(f"{len(files)} schemas written to {folder}")
