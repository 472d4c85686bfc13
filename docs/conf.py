"""The book: every document of the repository as a page, with the links that it has on a forge.

    pip install '.[docs]' && sphinx-build -W -c docs . target/book

The source folder is the root, so that pages outside `docs` (MODEL.md, results/README.md) need no copy. Notebooks are executed.
"""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
project = "metasense"
author = "the metasense developers"
release = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["version"]
extensions = ["myst_nb", "sphinx.ext.autodoc"]
root_doc = "docs/index"
include_patterns = ["*.md", "*/README.md", "results/DEVIATIONS.md", "worker/numerics/MODEL.md", "orchestrator/python/README.md", "docs/**"]
exclude_patterns = ["target", ".*", "docs/joss/paper.md"]
myst_heading_anchors = 4  # as a forge names them
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_execution_timeout = 300
autodoc_mock_imports = ["jax"]
autodoc_member_order = "bysource"
html_theme = "furo"
html_title = f"metasense {release}"
html_extra_path = ["_root"]


def without_folders(app, docname, source):
    """Links to folders, which a forge lists and a site does not have, become text."""
    page = Path(app.env.doc2path(docname))
    if page.suffix == ".md":
        source[0] = re.sub(
            r"(?<!!)\[([^\]]*)\]\(([^)#:\s]+)\)",
            lambda link: link[1] if (page.parent / link[2]).is_dir() else link[0],
            source[0],
        )


def setup(app):
    app.connect("source-read", without_folders)
