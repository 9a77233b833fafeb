"""``python -m side_info.schemas``: write the schema anew."""

from pathlib import Path

from side_info.schemas import FILE, generate

if __name__ == "__main__":
    path = Path(__file__).parent / FILE
    path.write_text(generate(), encoding="utf-8")
    print(f"schema written to {path}")
