"""The site: pages from docs/, split where they are long, and pages written by the program's own declarations.

    .ci/site [FOLDER]        builds, checks and tries everything in a clean environment

``python -m website OUT``, with ``docs`` on the path of Python, builds the pages into OUT/html.
"""
