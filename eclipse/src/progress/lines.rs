//! JSON on standard error, a line an event.

use std::{
    io::{Write, stderr},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use serde::Serialize;

/// Lines of one stage come no closer than this: a program that draws them needs no more.
const INTERVAL: Duration = Duration::from_millis(100);

/// Work under way; what is not known is left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event<'a> {
    /// Always `progress`.
    pub event: &'static str,
    /// What is being done.
    pub stage: &'a str,
    /// Iterations or pictures that are done.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub done: Option<u64>,
    /// How many there will be.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub of: Option<u64>,
    /// The part of the work that is done, of [0, 1].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub share: Option<f64>,
    /// The loss after the last iteration.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loss: Option<f64>,
    /// Shaded samples per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples_per_second: Option<f64>,
    /// Seconds of solving so far.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Seconds to the end at the pace so far.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds_left: Option<f64>,
}

impl<'a> Event<'a> {
    /// That `stage` is under way.
    pub fn stage(stage: &'a str) -> Self {
        Self {
            event: "progress",
            stage,
            done: None,
            of: None,
            share: None,
            loss: None,
            samples_per_second: None,
            seconds: None,
            seconds_left: None,
        }
    }
}

/// Writes events, of one stage not too many.
#[derive(Debug, Default)]
pub struct Lines {
    last: Mutex<Option<(String, Instant)>>,
}

impl Lines {
    /// Writes the event, unless its stage had one just now.
    pub fn tell(&self, event: &Event<'_>) {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let due = last.as_ref().is_none_or(|(stage, when)| {
            stage != event.stage || when.elapsed() >= INTERVAL || event.share == Some(1.0)
        });
        if due {
            *last = Some((event.stage.to_owned(), Instant::now()));
            say(event);
        }
    }
}

/// Writes any record as one line, whole: those of several threads do not mix.
pub fn say(record: &impl Serialize) {
    if let Ok(mut line) = serde_json::to_vec(record) {
        line.push(b'\n');
        // A reader that has gone is no reason to stop.
        let _ = stderr().lock().write_all(&line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_unknown_is_left_out() {
        let event = Event {
            done: Some(3),
            of: Some(12),
            share: Some(0.25),
            ..Event::stage("pictures")
        };
        assert_eq!(
            serde_json::to_string(&event).unwrap(),
            r#"{"event":"progress","stage":"pictures","done":3,"of":12,"share":0.25}"#
        );
    }
}
