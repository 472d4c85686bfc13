//! Prints lines on standard output and standard error. If these are closed or full, `println!` and `eprintln!` panic.

/// Prints a line on standard error; ignores failures.
#[macro_export]
macro_rules! say {
    ($($line:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($line)*);
    }};
}

/// Prints a line on standard output; returns the result of `writeln!`, but ignores a closed pipe.
#[macro_export]
macro_rules! print_line {
    ($($line:tt)*) => {{
        use std::io::Write as _;
        $crate::cli::unless_closed(writeln!(std::io::stdout(), $($line)*))
    }};
}

/// Ignores that the reader of standard output has closed it: the command still writes its files and has its own exit code.
pub fn unless_closed(printed: std::io::Result<()>) -> std::io::Result<()> {
    printed.or_else(|e| if e.kind() == std::io::ErrorKind::BrokenPipe { Ok(()) } else { Err(e) })
}

/// The result of a command whose command line is invalid.
macro_rules! usage {
    ($($why:tt)*) => {
        Err($crate::cli::Error::Usage(format!($($why)*)))
    };
}
