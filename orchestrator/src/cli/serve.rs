//! `serve`: shows sweeps in a browser, during and after a run.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::net::TcpListener;

use super::{Error, end_with};
use crate::cluster::home::attempts;
use crate::exit::Exit;
use crate::reader::Reader;
use crate::serve::{Address, ServerState, Token, WatchedDatabase, serve};
use crate::signals::Signals;

/// Shows databases in a browser, live, until Ctrl-C
///
/// The pages show progress, answers so far, all trials, and SQL queries. Everyone who has the printed address can read
/// them; other users of the machine cannot.
/// The server only reads databases and does not disturb runs. From another machine: ssh -L 8017:localhost:8017 HOST. With
/// --control, the pages can control runs (see `control`).
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Databases, folders of shards (each as one database), folders of databases
    #[arg(default_value = "results", value_name = "DB|FOLDER")]
    what: Vec<PathBuf>,
    /// Port, or IP:PORT, at which the server listens; port 0 takes any free port. Connections to other machines are not
    /// encrypted
    #[arg(long, value_name = "[IP:]PORT", default_value = "8017", value_parser = address, help_heading = "Address")]
    listen: SocketAddr,
    /// The address of these pages behind a proxy, such as https://hub.example.org/node/HOST/8017/; may be repeated. Leave
    /// out a path that the proxy removes, as jupyter-server-proxy does. All pages of this host can read these pages, and
    /// control runs if these pages can
    #[arg(long, value_name = "URL", help_heading = "Address")]
    proxy: Vec<String>,
    /// Prints an address with a token; everyone who has it can also control this user's runs of these databases
    #[arg(long)]
    control: bool,
    /// Ends with this parent process
    #[arg(long, hide = true, value_name = "PID")]
    parent: Option<u32>,
}

/// Parses PORT, of the loopback address, or IP:PORT.
fn address(text: &str) -> Result<SocketAddr, String> {
    match text.parse() {
        Ok(port) => Ok(SocketAddr::new(Ipv4Addr::LOCALHOST.into(), port)),
        Err(_) => text.parse().map_err(|_| "must be PORT or IP:PORT, such as 8017 or 0.0.0.0:8017".into()),
    }
}

/// Added to the niceness: runs have priority.
const NICENESS: i32 = 10;
/// Threads of the runtime, which wait most of the time.
const THREADS: usize = 6;

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    if args.parent.is_some_and(|parent| !end_with(parent)) {
        return Ok(Exit::Interrupted);
    }
    // SAFETY: the call cannot fail and touches no memory.
    unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICENESS) };
    // a runtime with several threads: reading a large database blocks one of them
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(THREADS).enable_all().build();
    let runtime = runtime.map_err(Error::io("starting", "the runtime"))?;
    let served = std::thread::spawn(move || runtime.block_on(serve_until_stopped(args)));
    served.join().expect("no page panics")
}

async fn serve_until_stopped(args: Args) -> Result<Exit, Error> {
    let mut signals = Signals::new()?;
    let paths: Vec<PathBuf> = args.what.iter().flat_map(|path| databases(path)).collect();
    if paths.is_empty() {
        return usage!(
            "no database in {}; `metasense run SPEC` creates one",
            args.what.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
        );
    }
    if let Some(missing) = args.what.iter().find(|path| !path.exists()) {
        return usage!("{}: no such database or folder", missing.display());
    }
    for path in args.what.iter().filter(|path| path.is_file()) {
        Reader::open(path).await?.close().await;
    }
    if args.control && !args.listen.ip().is_loopback() {
        return usage!(
            "--control: only for this machine's own address, because other connections are not encrypted; use ssh -L"
        );
    }
    let address = Address::new(&args.proxy).map_err(Error::Usage)?;
    let failed = |error: std::io::Error| {
        Error::Usage(format!("--listen {}: {error}; pass another port, or 0 for any free port", args.listen))
    };
    let listener = TcpListener::bind(args.listen).await.map_err(failed)?;
    let at = listener.local_addr().map_err(failed)?;
    let sources: std::io::Result<Vec<_>> = paths.iter().map(|path| WatchedDatabase::new(path)).collect();
    let sources = sources.map_err(Error::io("making a folder in", std::env::temp_dir()))?;
    let random = Error::io("reading", "/dev/urandom");
    let (reading, key) = Token::new().map_err(&random)?;
    let steering = args.control.then(Token::new).transpose().map_err(random)?;
    let (steering, behind) =
        steering.map_or((None, String::new()), |(token, text)| (Some(token), format!("#token={text}")));
    print_line!("http://{at}{}/?key={key}{behind}", address.base())?;
    if !at.ip().is_loopback() {
        say!("connections to {at} are not encrypted: others on the network can read these databases");
    }
    if let [only] = &sources[..] {
        // starts reading before the first request
        drop(only.watched());
    }
    let served = ServerState::new(sources, reading, steering, address);
    signals.or_signal(serve(listener, Arc::clone(&served))).await;
    served.close().await;
    Ok(Exit::Done)
}

/// The path itself for a file or a folder of shards; for another folder, all databases in it.
fn databases(path: &Path) -> Vec<PathBuf> {
    let is_database =
        |path: &PathBuf| path.extension().is_some_and(|e| e == "sqlite") || !attempts(path).is_empty();
    let shards = path.extension().is_some_and(|e| e == "shards") || !attempts(path).is_empty();
    if !path.is_dir() || shards {
        return vec![path.to_owned()];
    }
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut found: Vec<PathBuf> = entries.filter(is_database).collect();
    found.sort();
    found
}
