"""Self-contained HTML pages: one file each, no network, no script from elsewhere.

    frame.py        page(): title, sections, style and behaviour in one file, under a policy that forbids the rest
    pieces.py       the parts of sections: table, facts, figure, chart, note list, masthead
    charts.py       line charts, dot charts and bars as SVG
    pictures.py     arrays as pictures inside the page, within a budget of bytes
    camera_path.py  a camera path from above as SVG
    next_steps.py   what to try next: the remedies of the run's findings
    run_evidence.py the contents of a run folder, read as untrusted input
    run_pictures.py which pictures a run's page shows
    tradeoff_section.py  the section of a run's page on accuracy against time
    run_page.py     the page of a run
    templates/      the HTML, CSS and JavaScript, by hand

Every text passes through Jinja's escaping; only `templates/` and these modules produce markup.
"""
