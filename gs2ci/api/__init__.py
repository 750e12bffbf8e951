"""What `gs2ci` offers to people who write Python, and what its commands are made of.

    shots.py           load, save, import_file, recover
    runs.py            Run, open_run
    reconstruction.py  reconstruct
    many.py            reconstruct_many
    decoding.py        decode; decoders.py: which words name which decoder
    scoring.py         evaluate, measure
    exports.py         export, mesh
    costs.py           tradeoff
    designing.py       design
    rigs.py            OpenRig, open_rig, find_devices; live_page.py: LivePage
    plans.py           plan, demo's rig file; sweeps.py: sweep, plans along a figure of the rig
    models.py          add_model, export_model, list_models
    display.py         what a person sees of a long computation, at a terminal and in a notebook
    options.py         which numbers are allowed; overrides.py: what arguments mean for settings

`gs2ci.__init__` names what is public. Not here: parsing and printing (`gs2ci.commands`).
"""
