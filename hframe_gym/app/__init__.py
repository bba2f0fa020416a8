"""The window `hframe app`: a local page for the loop from a machine and its logs to controllers and exports.

Everything that it does is a command line, which it shows, runs in another process and keeps in the session,
so that a session can be repeated by a script. Modules without user interface come first, then one module for
each stage.

session          folder of a session, and the command line of each step
jobs             run command lines in processes; their output, their progress, and how to end them
log_columns      columns of logs, what they were taken for, and values that are few enough to be drawn
stage_drawing    plan view of a machine as shapes that follow the tool
server           server on the loopback address with a token
window           the window, and a page for each browser tab
page             the tabs of a page; what all stages have: commands, output of jobs
elements         what stages consist of: sentences, tables, charts
charts           options of charts with several curves over time
stages/          machine, logs, check, identify, results, control, export

It needs the extra `app`.
"""
