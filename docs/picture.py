"""A picture of a terminal (SVG) of a demonstration's output: picture.py OUTPUT.txt PICTURE.svg COMMAND."""

import sys

from rich.console import Console
from rich.text import Text

source, picture, command = sys.argv[1:]
lines = open(source, encoding="utf-8").read().rstrip().splitlines()
console = Console(record=True, width=max(map(len, lines)) + 1, file=open("/dev/null", "w"))
console.print(Text(f"$ {command}", style="bold green"))
for line in lines:
    console.print(Text(line), soft_wrap=True)
console.save_svg(picture, title=command)
