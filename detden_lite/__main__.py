"""``python -m detden_lite``: the recipe on the command line, as ``detden`` is."""

from detden_lite.recipe.cli import main

if __name__ == "__main__":
    main()
