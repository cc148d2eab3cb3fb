"""The README for a package index: without what leads nowhere there, pictures and links to the repository's files."""

import re
from pathlib import Path

from setuptools import setup

text = (Path(__file__).parent / "README.md").read_text(encoding="utf-8")
text = re.sub(r"!\[[^]]*\]\((?!https?:)[^)]*\)\n\n(?:.+\n)*\n", "", text)  # a picture and its caption
text = re.sub(r"\[([^]]+)\]\((?!https?:)[^)]*\)", r"\1", text)
setup(long_description=text, long_description_content_type="text/markdown")
