"""Write the generated parts of the reference pages: `python -m docs.ext`."""

from docs.ext.pages import FOLDER, generated

if __name__ == "__main__":
    for page in sorted(FOLDER.glob("*.md")):
        before = page.read_text("utf-8")
        after = generated(before)
        if after != before:
            page.write_text(after, "utf-8", newline="\n")
            print(f"written: {page.name}")
