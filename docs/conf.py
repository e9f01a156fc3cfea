"""How Sphinx makes the documentation: `make docs`."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import canser  # noqa: E402 - the path comes first
import generate  # noqa: E402 - beside this file
import pictures  # noqa: E402

project = "canser"
author = "the canser developers"
copyright = author  # noqa: A001 - Sphinx calls it so
version = release = canser.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["generated"]
nitpicky = False

# Pages are written in Markdown; `:::` directives read well as plain text, too.
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # the notebook is run by the tests, and shown as it is

# Types stand in the docstrings, in words; a signature with all of them is not readable.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_preprocess_types = False

html_theme = "furo"
html_title = "canser"
html_static_path = ["_static"]
html_theme_options = {"navigation_with_keys": True}
html_copy_source = False

generate.write_pages(HERE / "generated")
pictures.write_pictures(HERE / "generated" / "pictures")
