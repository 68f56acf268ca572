"""Settings of Sphinx. Nothing is fetched from elsewhere: fonts are the system's, formulas are MathML."""

from pathlib import Path

from robodyn_cli.version import __version__

project = "robodyn"
author = "The robodyn authors"
copyright = author
version = release = __version__
extensions = ["myst_nb", "website.mathml"]
root_doc = "index"
html_theme = "furo"
html_title = f"robodyn {version}"
html_static_path = [str(Path(__file__).parent / "static")]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_show_sphinx = False
html_copy_source = False
html_math_renderer = "mathml"
smartquotes = False
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 4
nb_execution_mode = "force"  # a cell that fails ends the build
nb_execution_raise_on_error = True
nb_execution_timeout = 300
suppress_warnings = ["myst.header"]  # pages that begin below a first heading
highlight_language = "none"
pygments_style, pygments_dark_style = "a11y-high-contrast-light", "a11y-high-contrast-dark"
