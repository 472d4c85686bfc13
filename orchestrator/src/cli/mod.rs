//! The command line: one file per command.
//!
//! A new command is a file with `Args` and `execute`, and a word in the list [`commands!`] below, at the top or in a group.

#[macro_use]
mod say;

mod analyse;
mod archive;
mod bound;
mod capacity;
mod casts;
mod check;
mod completions;
mod control;
mod design;
mod draw;
mod error;
mod evaluate;
mod expand;
mod export;
mod gc;
mod identify;
mod init;
mod live;
pub mod log;
mod man;
mod merge;
mod modes;
mod named;
mod operator;
mod pages;
mod place;
mod point;
mod project;
mod query;
mod remove;
mod report;
mod results;
mod run;
mod schema;
mod serve;
pub mod simd;
mod simulate;
mod spec_body;
mod status;
mod submit;
mod tasks;
mod trial;
mod unfinished;
mod verify;
mod warnings;
mod watch;

use std::ffi::{OsStr, OsString};
use std::fmt::Write as _;
use std::fs::Metadata;
use std::io::IsTerminal;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::pin::Pin;
use std::process::ExitCode;
use std::sync::OnceLock;

use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};
use rustix::process::{Signal, set_parent_process_death_signal};

use crate::exit::{EXIT_CODES, Exit};
use crate::signals::ignores_hangup;
use metasense_worker::{limits, process};

pub use crate::look::Format;
use crate::look::{Table, duration, screen};
pub use error::{Error, with_causes};
pub use say::unless_closed;

/// Maximum width of help texts (columns).
const WIDEST: usize = 100;

/// Trains bodies of flexible metamaterial together with the decoders that estimate forces from their signals, in sweeps of
/// many variants.
///
/// A sweep is a spec file (TOML) that expands into trials. Each trial trains one body with its decoder. `run` runs the
/// trials in worker processes and stores everything in one SQLite file. After a stop or a crash, the same command resumes
/// the run.
#[derive(Debug, Parser)]
#[command(name = "metasense", version, after_help = EXIT_CODES, max_term_width = WIDEST)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// Declares commands, each with its module, under headings, and groups of commands.
macro_rules! commands {
    (
        $($heading:literal: $($variant:ident $module:ident),+;)+
        $(#[doc = $about:literal] $Group:ident $group:ident: $($inner:ident $file:ident),+;)+
    ) => {
        #[derive(Debug, Subcommand)]
        enum Command {
            $($($variant($module::Args),)+)+
            $(#[doc = $about] #[command(subcommand)] $Group($Group),)+
            /// Worker process that the orchestrator starts; not for users.
            #[command(hide = true)]
            Worker {
                /// Where to connect.
                start: String,
            },
        }

        $(#[doc = $about]
        #[derive(Debug, Subcommand)]
        enum $Group {
            $($inner($file::Args),)+
        })+

        /// Names of top-level commands by heading.
        pub const TOP: &[(&str, &[&str])] = &[$(($heading, &[$(stringify!($module)),+])),+];

        /// Groups of commands, with the names of their commands.
        pub const GROUPS: &[(&str, &[&str])] = &[$((stringify!($group), &[$(stringify!($file)),+])),+];

        impl Command {
            async fn execute(self) -> Result<Exit, Error> {
                match self {
                    // Boxed, so that this future is not as large as the largest command's.
                    $($(Self::$variant(args) => Box::pin($module::execute(args)).await,)+)+
                    $($(Self::$Group($Group::$inner(args)) => Box::pin($file::execute(args)).await,)+)+
                    Self::Worker { .. } => unreachable!("carried out before"),
                }
            }
        }
    };
}

commands! {
    "A sweep": Init init, Run run, Design design, Expand expand, Trial trial, Status status, Watch watch, Serve serve, Control control;
    "Results": Query query, Analyse analyse, Report report, Export export, Archive archive, Remove remove;
    /// Computes properties of single bodies, without a sweep
    Body body: Draw draw, Simulate simulate, Modes modes, Bound bound, Operator operator, Place place, Casts casts, Tasks tasks, Capacity capacity, Project project;
    /// Compares bodies with measured records and reference data
    Lab lab: Check check, Identify identify, Evaluate evaluate, Verify verify;
    /// Prints what editors, shells and manuals use
    Setup setup: Schema schema, Completions completions, Man man;
    /// Runs a sweep as shards on a cluster or on several machines
    Cluster cluster: Submit submit, Merge merge, Gc gc;
}

/// The current name of a command that was moved, renamed or merged.
fn renamed(name: &str) -> Option<String> {
    let group = GROUPS.iter().find(|(_, names)| names.contains(&name));
    match (name, group) {
        ("claims", _) => Some("analyse --question claims".into()),
        ("twin" | "lab twin", _) => Some("lab identify --fit variation".into()),
        (_, group) => group.map(|(group, _)| format!("{group} {name}")),
    }
}

/// The clap command. Its help lists commands by heading, and the commands of each group.
pub fn command() -> clap::Command {
    let command = Cli::command();
    let (header, literal) = (command.get_styles().get_header(), command.get_styles().get_literal());
    let line = |name: &str| {
        let about = command.find_subcommand(name).and_then(clap::Command::get_about);
        let about = about.map(ToString::to_string).unwrap_or_default();
        format!("  {literal}{name:12}{literal:#}{about}\n")
    };
    let mut list = String::new();
    for (heading, names) in TOP {
        let _ = writeln!(list, "{header}{heading}:{header:#}");
        names.iter().for_each(|name| list += &line(name));
        list.push('\n');
    }
    let _ = writeln!(list, "{header}Groups of commands:{header:#}");
    for (group, names) in GROUPS {
        let _ = writeln!(list, "{}{:14}{}", line(group), "", names.join(", "));
    }
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}\n{header}Options:{header:#}\n{{options}}{{after-help}}"
    );
    allow_negative_numbers(command).help_template(template)
}

/// Accepts negative numbers as values, so that the check of each value can refuse them with its own message.
fn allow_negative_numbers(command: clap::Command) -> clap::Command {
    let arg = |arg: clap::Arg| {
        let takes = arg.get_action().takes_values();
        if takes { arg.allow_negative_numbers(true) } else { arg }
    };
    command.mut_args(arg).mut_subcommands(allow_negative_numbers)
}

/// Executes a command line whose first word is the name of the program.
pub fn execute(args: impl Iterator<Item = OsString>) -> Result<Exit, Error> {
    let args: Vec<OsString> = args.collect();
    let words: Vec<&str> = args.iter().skip(1).take(2).map_while(|word| word.to_str()).collect();
    let names = [words.first().map(|name| (*name).to_owned()), Some(words.join(" "))];
    if let Some((new, old)) = names.into_iter().flatten().find_map(|old| Some((renamed(&old)?, old))) {
        return usage!("`metasense {old}` is now `metasense {new}`");
    }
    let command = command().term_width(screen().unwrap_or(WIDEST).min(WIDEST)).color(colour());
    let matches = command.get_matches_from(args);
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|e| e.exit());
    check_outputs(&matches)?;
    process::keep_memory();
    limits::raise_limits();
    match cli.command {
        Command::Worker { start } => std::process::exit(process::run(&start, process::perform_trial)),
        command => block_on(command.execute()),
    }
}

/// Refuses output files that cannot be written, before a long computation, and those that the same command line reads; `merge` may
/// read its result, because it keeps the contents.
///
/// # Errors
/// If an output file is a folder or lacks one, or is also an input file, or an output folder is a file.
fn check_outputs(matches: &ArgMatches) -> Result<(), Error> {
    let Some((name, matches)) = matches.subcommand().filter(|(name, _)| *name != "merge") else {
        return Ok(());
    };
    if matches.subcommand().is_some() {
        return check_outputs(matches);
    }
    let named = |id: &str| matches.try_get_raw(id).ok().flatten().into_iter().flatten();
    let inode = |path: &OsStr| {
        let file = std::fs::metadata(path).ok().filter(Metadata::is_file)?;
        Some((file.dev(), file.ino()))
    };
    let written = ["out", "design_out"];
    if let Some(folder) = named("out_dir").map(Path::new).find(|folder| folder.exists() && !folder.is_dir()) {
        return usage!("--out-dir {}: is not a folder; choose another name", folder.display());
    }
    // `submit` merges into its file and creates the folder; a device is a folder
    let is_file = name != "submit" && !named("format").any(|format| format == "device");
    for (id, out) in written.into_iter().flat_map(|id| named(id).map(move |out| (id, out))) {
        if is_file {
            check_writable(id, Path::new(out))?;
        }
        let read = matches.ids().map(clap::Id::as_str).filter(|id| !written.contains(id)).flat_map(named);
        if inode(out).is_some_and(|place| read.into_iter().any(|path| inode(path) == Some(place))) {
            let out = out.display();
            return usage!("{out}: `{name}` reads this file; choose another file to write");
        }
    }
    Ok(())
}

/// Checks that a file may lie at this path.
fn check_writable(id: &str, file: &Path) -> Result<(), Error> {
    let folder = crate::files::folder(file);
    let why = match folder.is_dir() {
        _ if file.is_dir() => "is a folder; pass a file".to_owned(),
        true => return Ok(()),
        false if folder.exists() => format!("{} is not a folder; choose another", folder.display()),
        false => format!("the folder {} does not exist; create it", folder.display()),
    };
    Err(Error::Usage(format!("--{} {}: {why}", id.replace('_', "-"), file.display())))
}

/// The exit code of the program; prints an error.
pub fn exit_code(ended: Result<Exit, Error>) -> ExitCode {
    let exit = ended.unwrap_or_else(|e| match e.is_broken_pipe() {
        // The program that reads our output has closed the pipe of a command that only prints.
        true => Exit::Done,
        false => {
            e.say();
            e.exit()
        }
    });
    exit.into()
}

/// Runs a command in its own runtime.
pub fn block_on<T: 'static>(future: impl Future<Output = Result<T, Error>> + 'static) -> Result<T, Error> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(Error::io("starting", "the runtime"))?;
    // Boxed: the runtime's loop is compiled once, not per command.
    let future: Pin<Box<dyn Future<Output = Result<T, Error>>>> = Box::pin(future);
    runtime.block_on(future)
}

/// Makes signals end the program at once with the exit code of an interruption, for commands that write results only at the end.
/// The handler is our own: the system installs it atomically, whereas a runtime loses signals that arrive during registration.
fn end_on_signal(kept: Option<&Path>) {
    static SAID: OnceLock<String> = OnceLock::new();
    extern "C" fn end(_: libc::c_int) {
        let said = SAID.get().map_or("", String::as_str);
        // SAFETY: both functions are async-signal-safe; the text never changes.
        unsafe {
            libc::write(libc::STDERR_FILENO, said.as_ptr().cast(), said.len());
            libc::_exit(Exit::Interrupted as i32)
        }
    }
    let next = kept.map_or("starts again", |_| "resumes from here");
    SAID.get_or_init(|| format!("stopped; the same command {next}\n"));
    let hangup = Some(libc::SIGHUP).filter(|_| !ignores_hangup());
    for signal in [libc::SIGINT, libc::SIGTERM].into_iter().chain(hangup) {
        // SAFETY: `end` only does what a signal handler may do.
        unsafe { libc::signal(signal, end as *const () as libc::sighandler_t) };
    }
}

/// Whether `out` is a terminal that can move the cursor.
fn is_live(out: &impl IsTerminal) -> bool {
    let term = std::env::var_os("TERM").unwrap_or_default();
    out.is_terminal() && !term.is_empty() && term != "dumb"
}

/// No colours on a dumb terminal or with NO_COLOR, whatever CI or CLICOLOR are.
fn colour() -> clap::ColorChoice {
    let set = |key: &str| std::env::var_os(key).filter(|value| !value.is_empty());
    match set("NO_COLOR").is_some() || set("TERM").is_none_or(|term| term == "dumb") {
        true => clap::ColorChoice::Never,
        false => clap::ColorChoice::Auto,
    }
}

/// Requests SIGTERM at the end of the parent process. Returns whether `parent` is still running.
fn end_with(parent: u32) -> bool {
    let _ = set_parent_process_death_signal(Some(Signal::TERM));
    std::os::unix::process::parent_id() == parent
}

/// Number of threads of a foreground command: one per available core. Results do not depend on it.
fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Prints rows to standard output, see [`unless_closed`].
///
/// # Errors
/// If standard output is full, or, for Parquet, a terminal.
pub fn print_rows(table: &Table, format: Format) -> std::io::Result<()> {
    unless_closed(crate::look::print_rows(table, format))
}

/// Writes a whole file.
fn write(path: &Path, bytes: impl AsRef<[u8]>) -> Result<(), Error> {
    crate::files::write(path, bytes.as_ref()).map_err(Error::io("writing", path))
}

/// Prints the path of a result, unless the result went to a pipe or standard output.
fn print_path(path: &Path) -> std::io::Result<()> {
    if crate::files::is_stream(path) { Ok(()) } else { print_line!("{}", path.display()) }
}

/// Creates a folder if it is missing.
fn make_folder(path: &Path) -> Result<(), Error> {
    std::fs::create_dir_all(path).map_err(Error::io("making the folder", path))
}

#[cfg(test)]
mod tests;
