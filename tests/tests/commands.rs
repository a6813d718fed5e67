//! The program as a child process: what it prints, writes, refuses and goes on with.

mod cli;
mod cli_reading;
mod cli_reconstruct;
mod cli_relight;
mod cli_resume;
mod cli_studies;
mod cli_words;
mod many_captures;
mod progress;
mod storage;
