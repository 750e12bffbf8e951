"""Self-contained HTML pages: one file each, no network, no script from elsewhere.

    frame.py        page(): title, sections, style and behaviour in one file, under a policy that forbids the rest
    pieces.py       what sections are made of: table, facts, figure, chart, note list, masthead
    charts.py       line charts, dot charts and bars as SVG
    pictures.py     arrays as pictures inside the page, within a budget of bytes
    camera_path.py  a camera path from above as SVG
    next_steps.py   what a run's evidence says to try next: the rules
    run_evidence.py what a run folder holds, read as untrusted input
    run_pictures.py which pictures a run's page shows
    tradeoff_section.py  what accuracy costs: its section of a run's page
    run_page.py     the page of a run
    templates/      the HTML, CSS and JavaScript, by hand

Every text passes through Jinja's escaping; only what `templates/` and these modules write themselves is markup.
"""
