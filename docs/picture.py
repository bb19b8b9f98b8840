"""A picture of a terminal (SVG) of a demonstration's output: picture.py OUTPUT.txt PICTURE.svg COMMAND."""

import re
import sys
from os import devnull

from rich.console import Console
from rich.text import Text

source, picture, command = sys.argv[1:]
lines = [line.rstrip() for line in open(source, encoding="utf-8")]
console = Console(record=True, width=max(map(len, lines)) + 1, file=open(devnull, "w"))
console.print(Text(f"$ {command}", style="bold green"))
for line in lines:
    console.print(Text(line), soft_wrap=True)
console.save_svg(picture, title=command)
# A picture loads nothing from elsewhere: the viewer's own fonts do.
svg = open(picture, encoding="utf-8").read()
svg = re.sub(r"\s*@font-face \{.*?\n    \}", "", svg, flags=re.DOTALL)
open(picture, "w", encoding="utf-8").write(svg)
