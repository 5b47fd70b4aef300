"""What identify, validate, diagnose and the live twin share: records, filters, predictions, their noise floor."""
