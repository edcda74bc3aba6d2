"""`python -m camtopod` is the console script."""

from camtopod.cli import console

if __name__ == "__main__":
    console()
