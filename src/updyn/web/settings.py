"""Numbers that decide what the web app shows, accepts and waits for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WebPageSettings:
    """Content of pages."""

    #: [points] Points of a curve; of more, peaks are kept. Drawing: more than a screen has pixels.
    curve_points: int = 4000
    #: [points] Points of a curve in a small figure. Drawing: about two for each pixel of its width.
    small_points: int = 600
    #: [channels] Channels of a table that its preview reads. Drawing: the time of the browser.
    most_channels: int = 200
    #: [channels] Small figures on a page. Drawing: three columns fill a screen.
    page_channels: int = 12
    #: [lines] Lines of the map of all channels. Drawing: about three pixels each.
    map_lines: int = 400
    #: [px] Largest height of that map. Drawing: it fits a screen.
    map_height: int = 720
    #: [channels] Names along the axis of that map. Drawing: more would overlap.
    map_names: int = 40
    #: [dB] Range of levels in that map. Drawing: resonances and antiresonances of most tests.
    map_range: float = 80.0
    #: [dB] Largest difference of a model from the data in that map. Drawing: a factor of ten.
    map_difference: float = 20.0
    #: [px] Size of the text in small figures. Drawing: the smallest that is easily read.
    small_text: int = 11
    #: [channels] Channels of a table whose entries are shown at once. Drawing: a page of readable
    #: length.
    shown_channels: int = 20
    #: [lines] Lines of a table in its preview. Drawing: enough to tell a frequency from a value.
    preview_rows: int = 5
    #: [px] Height of the figure in the preview of a table. Drawing: form and preview fit a screen.
    preview_height: int = 260
    #: [lines] Measured lines at which the model is computed. Effort: each line takes time at each
    #: step of a run; a rule of thumb.
    model_lines: int = 400
    #: [steps] Steps of an ended run at which its level error is computed. Effort: each takes a
    #: response of the model; they show the course of a fit.
    level_steps: int = 30
    #: [DOFs] Size of a model up to which its responses are computed without being asked for.
    #: Effort: seconds.
    quick_dofs: int = 2000
    #: [modes] Modes of the start that are shown on request. Effort: a limit of time; a rule of
    #: thumb.
    shown_modes: int = 12
    #: [modes] Modes that the address of a structure may request. Effort: a rule of thumb.
    most_modes: int = 100
    #: [runs] Runs on a page of their table. Drawing: the selected run is on the same screen.
    listed_runs: int = 6
    #: [files] Files of a folder without a job that are read to find a model and a measurement.
    #: Effort: each is read.
    recognised_files: int = 20
    #: [characters] Part of a wrong entry that a message quotes. Drawing: the message stays in one
    #: line.
    quoted_characters: int = 40
    #: [s] Interval at which a page checks for changes. Effort: a user notices no delay.
    refresh_interval: float = 0.5
    #: [edits] Edits that can be undone. Effort: the text of each is in memory.
    undo_steps: int = 200
    #: [s] Pause in typing that begins another edit. Effort: about a sentence at a time.
    typing_pause: float = 2.0


@dataclass(frozen=True)
class WebLimitSettings:
    """Limits of requests and of the folder of a project."""

    #: [bytes] Largest uploaded file. Effort: it is in memory while it is received.
    upload_bytes: int = 256 * 2**20
    #: [bytes] Form data in addition to an uploaded file. Effort: headers and names.
    form_bytes: int = 2**16
    #: [bytes] Largest message of a page. Effort: a job file with its edits.
    message_bytes: int = 4 * 2**20
    #: [levels] Depth of folders in which jobs and results are searched. Effort: a rule of thumb.
    folder_depth: int = 4
    #: [folders] Folders in which jobs and results are searched. Effort: a rule of thumb.
    most_folders: int = 2000
    #: [bytes] Largest name of a file. Effort: file systems accept 255, less the part that a
    #: temporary name adds.
    name_bytes: int = 200
    #: [characters] Largest first line of a job file that is read. Effort: a path has 4096 bytes at
    #: most on Linux.
    line_characters: int = 4096


@dataclass(frozen=True)
class WebConnectionSettings:
    """Connection of a page to the server."""

    #: [s] Time without an answer after which the connection may be taken for lost: a test of it is
    #: sent every 0.8 of this time, and its answer awaited for 0.4 of it. Effort: longer than a
    #: computer is busy or asleep between two clicks, which would be lost with the connection.
    lost_after: float = 60.0
    #: [s] Time in which a page may connect anew after its connection has ended. Effort: until then
    #: the server also updates pages that were left.
    reconnect_seconds: float = 3.0


@dataclass(frozen=True)
class WebTaskSettings:
    """Processes behind the pages."""

    #: [s] Longest time that a page waits until a job is read or solved. Effort: reading a large
    #: model takes minutes.
    answer_seconds: float = 600.0
    #: [s] Time in which a killed process ends. Effort: the system needs far less.
    kill_seconds: float = 2.0
    #: [s] Time in which a stopped task may write its results. Effort: it also writes the report; a
    #: rule of thumb.
    stop_seconds: float = 60.0
    #: [s] Time in which the last lines on stderr are read after the end. Effort: they are in a pipe
    #: already.
    last_lines_seconds: float = 1.0
    #: [s] Shortest time between two messages of the same step. Effort: ten a second look
    #: continuous.
    message_interval: float = 0.1
    #: [steps] Steps of a task that are kept for the pages. Effort: a limit of memory, above any
    #: usual fit.
    kept_steps: int = 5000
    #: [notes] Notes of a task that are kept. Effort: a limit of memory.
    kept_notes: int = 200
    #: [lines] Lines on stderr of a task that are kept. Effort: a traceback.
    kept_error_lines: int = 50


WEB_PAGE = WebPageSettings()
WEB_CONNECTION = WebConnectionSettings()
WEB_LIMIT = WebLimitSettings()
WEB_TASK = WebTaskSettings()
