//! Prints lines on standard output and standard error. If these are closed or full, `println!` and `eprintln!` panic.

/// Prints a line on standard error; ignores failures.
#[macro_export]
macro_rules! say {
    ($($line:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($line)*);
    }};
}

/// Prints a line on standard output; returns the result of `writeln!`.
#[macro_export]
macro_rules! print_line {
    ($($line:tt)*) => {{
        use std::io::Write as _;
        writeln!(std::io::stdout(), $($line)*)
    }};
}
