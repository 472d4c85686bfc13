//! Lines for standard output and standard error, either of which may be closed or full: `println!` and `eprintln!` panic then.

/// Says a line on standard error. Where nobody takes it, the work goes on.
#[macro_export]
macro_rules! say {
    ($($line:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($line)*);
    }};
}

/// Prints a line to standard output; what `writeln!` gives.
#[macro_export]
macro_rules! print_line {
    ($($line:tt)*) => {{
        use std::io::Write as _;
        writeln!(std::io::stdout(), $($line)*)
    }};
}
