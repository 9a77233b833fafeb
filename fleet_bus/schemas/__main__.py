"""``python -m fleet_bus.schemas``: write the schema files anew, and the tables of the page about the wire."""

from pathlib import Path

from fleet_bus.schemas import generate, shipped
from fleet_bus.schemas.wire_page import rewritten

if __name__ == "__main__":
    folder = Path(__file__).parent
    files = generate()
    for name in shipped().keys() - files.keys():
        (folder / name).unlink()
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    print(f"{len(files)} schemas written to {folder}")
    page = folder.parents[1] / "docs" / "reference" / "wire.md"
    # An installed package has no documentation beside it.
    if page.exists():
        page.write_text(rewritten(page.read_text(encoding="utf-8")), encoding="utf-8")
        print(f"tables of {page} written")
