"""Write the tables of the documentation from benchmarks/results/*.json, and other pages from the library.

python -m tools.tables            # write
python -m tools.tables --check    # write nothing; fail if a page is out of date
"""

from __future__ import annotations

from hframe_gym.files import write_text
from tools.command_line import command_line
from tools.repository import ROOT
from tools.tables.pages import pages


def main() -> None:
    """Write all pages, or check that they are up to date."""
    parser = command_line(__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail if a page is out of date")
    check = parser.parse_args().check
    texts = pages()
    outdated = [path for path, text in texts.items() if not path.is_file() or path.read_text("utf-8") != text]
    if check and outdated:
        names = ", ".join(str(path.relative_to(ROOT)) for path in outdated)
        raise SystemExit(f"{names}: generated parts are out of date; run `make tables`")
    for path in outdated:
        write_text(path, texts[path])


if __name__ == "__main__":
    main()
