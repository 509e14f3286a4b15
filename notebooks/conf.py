"""How Sphinx makes the site: python -m sphinx -W notebooks build/site."""

import os
import sys
from importlib.metadata import version as installed
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_extensions"))
# Pictures are drawn without a display, and what one build compiles is of no use to another one.
os.environ["MPLBACKEND"] = "Agg"

project = "dipoletop"
author = "The dipoletop developers"
version = release = installed("dipoletop")
html_title = f"dipoletop {version}"
html_short_title = "dipoletop"

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # a copy of MathJax in the site: it works without a network
    "sphinx_copybutton",
    "sphinx_design",
    "myst_nb",
    "sphinx_gallery.gen_gallery",
    "api_pages",
    "benchmark_pages",
    "docstrings",
    "names",
]

exclude_patterns = [
    "gallery/*",
    "pictures/*.ipynb",  # downloads: the pages are made from the scripts
    "_extensions",
    "_static",
    "**.ipynb_checkpoints",
]
suppress_warnings = [
    # One name has one entry, which later pages link to.
    "ref.python",
]
default_role = "py:obj"
add_module_names = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
pygments_style = "default"

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "attrs_inline"]
myst_heading_anchors = 3
myst_dmath_double_inline = True
# Notebooks are committed with their outputs; tests/check_notebooks.py checks these.
nb_execution_mode = "off"
nb_merge_streams = True
nb_render_markdown_format = "myst"  # tables, too

autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True, "special-members": "__call__"}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = True

sphinx_gallery_conf = {
    "examples_dirs": ["gallery"],
    "gallery_dirs": ["pictures"],
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "reset_modules": ("gallery_setup.reset",),
    "image_scrapers": ("gallery_setup.figures",),
    "abort_on_example_error": True,
    "capture_repr": (),
    "backreferences_dir": "pictures/used",
    "doc_module": ("dipoletop",),
    "reference_url": {"dipoletop": None},
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "thumbnail_size": (400, 300),
    "remove_config_comments": True,
    "copyfile_regex": "",
}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
