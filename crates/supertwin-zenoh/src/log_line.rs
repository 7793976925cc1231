//! What a line of Zenoh's log says.

use std::fmt::{Debug, Write};
use tracing::Event;
use tracing::field::{Field, Visit};

/// The message of `event`.
pub(crate) fn message(event: &Event<'_>) -> String {
    let mut text = Text(String::new());
    event.record(&mut text);
    text.0
}

struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            // Writing to a string can't fail.
            let _ = write!(self.0, "{value:?}");
        }
    }
}
