"""The verbs of the command, one module each; :data:`fitter.cli.app.VERBS` lists them."""
